"""Numbers in the files that people write with their ranges, which msgspec checks."""

import sys
from typing import Annotated

from msgspec import Meta

Positive = Annotated[float, Meta(gt=0, le=sys.float_info.max)]  # no infinity
NotNegative = Annotated[float, Meta(ge=0)]
Count = Annotated[int, Meta(gt=0)]
Probability = Annotated[float, Meta(gt=0, lt=1)]
