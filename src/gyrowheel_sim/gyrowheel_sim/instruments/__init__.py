"""The instruments of the bench: readings, noise, drift, delays and filters; one sample of all of them is a row.

`readings` has the layout of the arrays, `kernel` computes the readings as part of the compiled plant, `response` their
frequency response.
"""
