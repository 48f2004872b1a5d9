"""What a model lacks: selection of effects, unknown forms, design of the next test, precision."""
