"""Data: what goes into scenes, and later into training.

    letters.py   characters as albedo bitmaps
"""
