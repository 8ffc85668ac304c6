"""Optimizers of an inversion."""
