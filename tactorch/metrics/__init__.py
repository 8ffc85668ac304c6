"""Metrics of a map of Young's modulus; fields are per element, MPa."""

from tactorch.metrics.fields import normalised_correlation, pearson, psnr, rmse_mpa, ssim_1d
from tactorch.metrics.inclusion import Inclusion, find_inclusion
from tactorch.metrics.localisation import contrast_recovery, dice, position_error_mm
from tactorch.metrics.scores import scores
from tactorch.metrics.volume import ssim

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
