"""DejaVu Sans, the font in matplotlib: equal on every machine."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import matplotlib
from matplotlib.font_manager import FontProperties, findfont
from PIL import ImageFont


@lru_cache(maxsize=64)
def dejavu_sans(size: int, weight: str = "normal", style: str = "normal") -> ImageFont.FreeTypeFont:
    """Return the font at a size in pixels; weight normal or bold, style normal or oblique."""
    wanted = FontProperties(family="DejaVu Sans", weight=weight, style=style)
    return ImageFont.truetype(findfont(wanted, directory=str(Path(matplotlib.get_data_path()) / "fonts" / "ttf")), size)
