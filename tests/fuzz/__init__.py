"""Fuzzing: input of every kind, damaged, ends with one line that says what is wrong or with the right answer.

``make fuzz MINUTES=5`` tries as many inputs as fit into that time, every kind in turn; a few of each are tried with the
other tests (`test_short`). What was found is kept with its smallest input (`test_findings`).

`damage` changes bytes and texts, `harness` tries one input under a limit of time and memory, and the modules of `KINDS`
make the inputs and say what is right.
"""
