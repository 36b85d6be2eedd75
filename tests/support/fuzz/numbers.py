"""Numbers and texts that programs often do not expect."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

Random = np.random.Generator

WHOLE = [0, 1, 2, 3, 5, 6, 7, 8, 15, 16, 17, 24, 31, 32, 33, 64, 100, 127, 128, 255, 256, 257]
WHOLE += [1000, 4095, 4096, 32767, 32768, 34892, 50000, 50001, 65534, 65535, 65536, 10**6, 10**7]
WHOLE += [2**24, 2**31 - 1, 2**31, 2**32 - 16, 2**32 - 1, 2**40, 2**63 - 1, 2**63, 2**64 - 1]
REAL = [0.0, -0.0, 1.0, -1.0, np.nan, np.inf, -np.inf, 1e308, -1e308, 1e300, 1e154, 1e38, 1e20]
REAL += [1e16, 1e-6, 1e-16, 1e-38, 1e-300, 1e-308, 5e-324, 90.0, -180.0, 360.0, 0.1, 1 / 3]
NUMBERS = [*map(str, WHOLE), "nan", "-nan", "inf", "-inf", "1e999", "-1e400", "1e308", "1e-320"]
NUMBERS += ["-1", "-9999", "0.1", "-0", "1,5", "0x10", "1e", "--1", "", " ", "abc", "1.7e308", "é"]
NUMBERS += ["-3.4028234663852886e38", "-3.40282346638529e+38", "9" * 400, "0." + "0" * 400 + "1"]


def pick(random: Random, items: Sequence[Any]) -> Any:
    return items[int(random.integers(len(items)))]
