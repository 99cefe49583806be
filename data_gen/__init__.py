"""Data: targets for scenes and for training, and their measurements.

letters.py       characters as albedo bitmaps for scenes
edges.py         targets: Canny edges of photographs
shapes.py        targets: glyphs, strokes, filled shapes
targets.py       targets by source, in blocks that depend on the seed alone
measurement.py   targets -> autocorrelation estimates, by noise model or by rendering
store.py         datasets as sharded Zarr groups with a manifest
work.py          one shard of a dataset
schedule.py      shards on parallel workers
dataset.py       datasets for torch
preview.py       contact sheet of a dataset
fonts.py         the font of the characters
"""
