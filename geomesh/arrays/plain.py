"""Plain values, as JSON has them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any


def plain_json(value: Any) -> Any:
    """Return a value as JSON can hold it.

    Mappings become dicts with text as keys, sequences lists, numpy's numbers Python's; a
    number that is not finite becomes None, for JSON has no NaN and no infinity.
    """
    if isinstance(value, Mapping):
        return {str(key): plain_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain_json(item) for item in value]
    if hasattr(value, "item"):
        return plain_json(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
