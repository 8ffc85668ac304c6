"""The data of an inversion: observations, their noise, misfits and nuisance parameters."""
