"""`python -m benchmarks.hio`: 16 starts of 2000-iteration HIO at 128 x 128 against 64 000 batched real FFT pairs."""

from __future__ import annotations

import time

import torch

from invert.hio import HioOptions, hio

STARTS, ITERATIONS, PAIRS, REPEATS = 16, 2000, 64_000, 3


def fft_pairs() -> float:
    """Seconds for 64 000 forward and inverse real 128 x 128 FFTs, 16 at a time."""
    batch = torch.rand(STARTS, 128, 128)
    begin = time.perf_counter()
    for _ in range(PAIRS // STARTS):
        torch.fft.irfft2(torch.fft.rfft2(batch), s=(128, 128))
    return time.perf_counter() - begin


def retrieval() -> float:
    """Seconds for one call of HIO with shrink-wrap."""
    image = torch.zeros(128, 128)
    image[14:47, 20:25], image[14:19, 20:42] = 1.0, 0.6
    modulus = torch.fft.rfft2(image).abs()
    begin = time.perf_counter()
    hio(modulus, 40, torch.Generator().manual_seed(0), HioOptions(iterations=ITERATIONS, starts=STARTS))
    return time.perf_counter() - begin


def main() -> None:
    fft_pairs(), retrieval()  # warm up
    for _ in range(REPEATS):
        reference, measured = fft_pairs(), retrieval()
        print(f"HIO {measured:.2f} s, FFT pairs {reference:.2f} s, ratio {measured / reference:.2f}")


if __name__ == "__main__":
    main()
