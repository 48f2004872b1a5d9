"""Which physical effect is missing: fitting, selection, ties, detection limits, the next test. No plotting here."""
