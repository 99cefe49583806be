"""Files: frames, captures, images, figures, stores.

capture.py         frames with the metadata of their camera, in memory
captured_frames.py frames of a camera, read and checked
capture_folder.py  folder of a capture, replaced as a whole
corrections.py     dark frames, flat-field frame, mask
exr_frames.py      EXR frames with their header (exr_version.py: one attribute of it)
images.py          monochrome images and arrays
figures.py         figures: saving, showing, scale bars
store.py           Zarr stores: ownership and completeness
output.py          folders and files, complete or absent; locks
manifest.py        which files a command may replace
"""
