"""Metrics of a map of Young's modulus; fields are per element, MPa."""

from tactorch.metrics.scores import (
    contrast_recovery,
    dice,
    normalised_correlation,
    pearson,
    position_error_mm,
    psnr,
    rmse_mpa,
    scores,
    ssim,
    ssim_1d,
)
from tactorch.metrics.segment import Inclusion, find_inclusion

__all__ = [
    "Inclusion",
    "contrast_recovery",
    "dice",
    "find_inclusion",
    "normalised_correlation",
    "pearson",
    "position_error_mm",
    "psnr",
    "rmse_mpa",
    "scores",
    "ssim",
    "ssim_1d",
]
