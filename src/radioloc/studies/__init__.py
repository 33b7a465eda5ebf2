"""Whole jobs: a study file in, a solution out."""
