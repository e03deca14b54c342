"""What χ² per degree of freedom says, and what to do where it is far from 1."""

import math

_FAR = 2.0
"""Sigmas that are off by less than √2 are as good as anybody states them."""


def noise_text(chi2_per_dof: float) -> str:
    """A line, or two where the noise is not as it was stated."""
    text = f"chi² per degree of freedom: {chi2_per_dof:.3f} (1: noise is what it was said to be)"
    if chi2_per_dof > _FAR:
        return (
            f"{text}\n  it is {math.sqrt(chi2_per_dof):.1f} times what was said: sigmas are too "
            "small by that; look at each camera's residuals in the report, give a better lens, or "
            "raise [robots.NAME.odometry] where all cameras have it"
        )
    if chi2_per_dof < 1 / _FAR:
        return (
            f"{text}\n  it is {math.sqrt(chi2_per_dof):.2f} of what was said, so sigmas are rather "
            "too large: no corner is believed better than 0.02 px (decisions/0661), which sharp "
            "pictures through a known lens are, and odometry may be better than its noise in the "
            "site file"
        )
    return text
