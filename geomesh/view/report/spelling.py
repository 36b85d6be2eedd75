"""Numbers as a report shows them."""

from __future__ import annotations

import math


def spell(value: float | None, digits: int = 4) -> str:
    """Return a number with so many significant digits, without an exponent where it can be."""
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    size = abs(value)
    if size >= 10 ** (digits - 1) and size < 1e15:
        return f"{value:,.0f}".replace("-", "−")
    if size and size < 1e-4:
        return f"{value:.{digits - 1}e}".replace("-", "−")
    return f"{value:.{digits}g}".replace("-", "−")


def place(value: float, step: float) -> str:
    """Return a coordinate with enough decimals to tell apart places that are `step` apart."""
    if not math.isfinite(value):
        return "–"
    decimals = max(math.ceil(-math.log10(step)), 0) if 0 < step < 1 else 0
    return f"{value:.{min(decimals, 12)}f}".replace("-", "−")
