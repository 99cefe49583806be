"""Comparison of methods: the command `invert.evaluate`.

    evaluate.py        every method on every level of a test set; goes on where it was stopped
    sets.py            edges, unseen characters, rendered and measured captures
    identification.py  which character a reconstruction shows
    report.py          tables, pictures, accuracy against time
"""
