"""The projector's nonlinearity: its response, the phase error that it makes, and three ways to take it away.

Arrays in, arrays out. Knows no contract, no file and no clock.
"""
