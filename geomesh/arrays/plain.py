"""Conversion of values to the types of JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any


def plain_json(value: Any) -> Any:
    """Return a value converted to the types of JSON.

    Mappings become dicts with text keys, sequences become lists, and numbers of numpy become
    numbers of Python. NaN and infinity become None, because JSON does not have them.
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
