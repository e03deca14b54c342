"""Numbers in the site file with their ranges, which msgspec checks."""

from typing import Annotated

from msgspec import Meta

Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
Count = Annotated[int, Meta(gt=0)]
Probability = Annotated[float, Meta(gt=0, lt=1)]
