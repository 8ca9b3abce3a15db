#!/usr/bin/env python3
"""Puts the screenshots of check.mjs into the documents: keep_pictures.py SCREENSHOTS docs/pictures.

Takes each page in light, in dark and on a phone, with a palette of 256 colours, which makes a file half as large.
Needs Pillow.
"""

import sys
from pathlib import Path

from PIL import Image

PAGES = ["fleet", "wall", "alarms", "robot", "alarm", "run", "cycle", "ingest"]
LOOKS = {"light": "", "dark": "-dark", "phone": "-phone"}

taken, kept = Path(sys.argv[1]), Path(sys.argv[2])
for page in PAGES:
    for look, ending in LOOKS.items():
        picture = Image.open(taken / f"{page}-{look}.png").convert("RGB")
        picture = picture.quantize(256, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
        picture.save(kept / f"dashboard-{page}{ending}.png", optimize=True)
