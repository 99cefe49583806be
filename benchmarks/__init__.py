"""Measurements behind the figures of the documentation; no test depends on them.

ablation.py               losses and mappings of the paper, trained small
cameras.py                predicted and reached exposures of random cameras
data_gen.py               samples per second of each kind of dataset
digest.py                 checksums of frames, estimates and albedos, to compare two versions of the code
exchangeability.py        ranks of the truth among the samples of the posterior
fields.py                 what fields add to the autocorrelation: pages, letters, exposures, bars
false_alarms.py           warnings about clean frames of random cameras and objects
hio.py                    time of HIO with 16 starts compared with that of the FFTs that it contains
invert.py                 two frames to an albedo, step by step
memory_effect.py          correlography compared with the memory effect
nuisances.py              what cameras and walls do to frames
pages.py                  pages of text, read by tesseract
posterior_calibration.py  how often the truth lies in the credible intervals of the posterior
random_captures.py       captures of random scenes, objects and cameras, for fields.py
scenes.py                 every scene rendered and inverted
speed_accuracy.py         every propagation kernel against the direct sum
stem_place.py             a stem located in noise, compared with an ideal observer
streaming.py              memory and speed of long captures and of the live view
"""
