"""Fitting parameters to observations, and saying how well they are known."""
