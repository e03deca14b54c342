"""What χ² per degree of freedom means, and what to do if it is far from 1."""

import math

_FAR = 2.0
"""Stated sigmas are rarely better than within a factor of √2."""


def noise_text(chi2_per_dof: float) -> str:
    """For the terminal: one line, or two if the noise is not as stated or as the session tells."""
    text = f"chi² per degree of freedom: {chi2_per_dof:.3f} (1: noise is as assumed)"
    if chi2_per_dof > _FAR:
        return (
            f"{text}\n  the noise is {math.sqrt(chi2_per_dof):.1f} times what was stated, and the "
            "sigmas are too small by as much; look at each camera's residuals in the report, give "
            "a better lens, or raise [robots.NAME.odometry] where all cameras have it"
        )
    if chi2_per_dof < 1 / _FAR:
        return (
            f"{text}\n  the noise is {math.sqrt(chi2_per_dof):.2f} times what was stated, so the "
            "sigmas are too large: no corner counts as better than 0.02 px, "
            "though sharp pictures through a known lens are, and the odometry may be better than "
            "the site file says"
        )
    return text


def noise_words(chi2_per_dof: float, noise: tuple[str, ...] = ()) -> str:
    """For a page, beside the number; `noise`: what is not as stated."""
    words = "χ² per degree of freedom; 1 where noise is as assumed"
    if noise:
        words += f", that is, of {'; of '.join(noise)}"
    if chi2_per_dof > _FAR:
        by = math.sqrt(chi2_per_dof)
        return f"{words}; sigmas are too small by {by:.1f}: see the residuals of each camera"
    if chi2_per_dof < 1 / _FAR:
        return f"{words}; sigmas are too large: corners or odometry are better than stated"
    return words
