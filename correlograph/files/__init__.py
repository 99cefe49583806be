"""Files: frames, captures, pictures, results.

capture.py         frames with the facts of their camera, in memory
capture_folder.py  the folder of them, replaced as a whole
corrections.py     dark frame, flat field, mask
frames.py          EXR frames with their header (exr_version.py: one attribute of it)
pictures.py        monochrome pictures and arrays of any kind
store.py           Zarr stores: whose they are, whether they are whole
output.py          folders and files, never half-written
"""
