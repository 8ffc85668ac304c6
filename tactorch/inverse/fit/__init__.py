"""Objectives, and the optimizers that minimise them, with starts and stopping rules."""
