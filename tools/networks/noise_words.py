"""What χ² per degree of freedom means, and what to do if it is far from 1."""

import math

_FAR = 2.0
"""Stated sigmas are rarely better than within a factor of √2."""


def noise_words(chi2_per_dof: float, noise: tuple[str, ...] = ()) -> str:
    """What stands beside the number; `noise`: what is not as stated."""
    words = "χ² per degree of freedom; 1 where noise is as assumed"
    if noise:
        words += f", that is, of {'; of '.join(noise)}"
    by = math.sqrt(chi2_per_dof)
    if chi2_per_dof > _FAR:
        return (
            f"{words}; sigmas are too small by {by:.1f}: look at each camera's residuals, "
            "give a better lens, or raise [robots.NAME.odometry] where all cameras have it"
        )
    if chi2_per_dof < 1 / _FAR:
        return (
            f"{words}; sigmas are too large, the noise is {by:.2f} times what was stated: no "
            "corner counts as better than 0.02 px, though sharp pictures through a known lens are, "
            "and the odometry may be better than the site file says"
        )
    return words
