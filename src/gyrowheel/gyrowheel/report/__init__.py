"""The report: one page of HTML that can be sent, with the result in words first and all that it rests on."""
