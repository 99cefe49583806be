"""The lag grid of estimates and albedos."""

LAGS = 63
"""Largest lag on either side of zero: estimates are 127 x 127, zero lag at [63, 63]."""

LAG_SIDE = 2 * LAGS + 1
"""Side of an estimate."""

OBJECT_SIDE = LAGS + 1
"""Side of an albedo on the lag grid."""
