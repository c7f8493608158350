"""CLIP ViT-B/32 with random weights: the JAX tower of the extra `[clip]` beside transformers on torch, in one run.

    python tests/benchmarks/clip_tower.py

Needs the `bench` extra. 1,000 images of 400 x 300 px are scaled, cut and normalised (by the same code, timed alone)
and go through both networks in float32; both have every core that this process may use. Contenders run by turns and
the best of three counts, so that a busy moment of the machine falls on all. Compiling is timed apart. The last lines
are the largest difference between both features, in units of their norm, and the ratio of the times.

Not timed on a quiet machine yet. What `pip install` of torch and transformers takes, 5.7 GB on Linux x86-64 (torch
2.14 with its CUDA libraries, transformers 5.24), is 35 MB with safetensors and huggingface-hub (34 of it the latter and
what it needs).
"""

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
import torch
import transformers

from ovibjax.features.backbones.by_name import open_backbone

HEIGHT_PX, WIDTH_PX, BATCH = 300, 400, 80


def random_model(folder: str) -> transformers.CLIPModel:
    """A model of the usual size, saved in a folder."""
    torch.manual_seed(0)
    text = {"hidden_size": 64, "intermediate_size": 64, "num_hidden_layers": 1, "num_attention_heads": 1}
    model = transformers.CLIPModel(transformers.CLIPConfig(text_config=text, vision_config={"patch_size": 32})).eval()
    model.save_pretrained(folder)
    return model


def timed(call: Callable[[], np.ndarray]) -> tuple[float, np.ndarray]:
    """Seconds, and what came of it."""
    start = time.perf_counter()
    found = call()
    return time.perf_counter() - start, found


def main() -> None:
    """Run both."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=1000)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    torch.set_num_threads(cores)
    print(f"{cores} cores, torch {torch.__version__}, transformers {transformers.__version__}", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        model = random_model(folder)
        seconds, backbone = timed(lambda: open_backbone(f"clip:{folder}"))
    print(f"weights read in {seconds:.2f} s", flush=True)
    rng = np.random.default_rng(0)
    images = rng.integers(0, 256, (options.images, HEIGHT_PX, WIDTH_PX, 3), np.uint8)
    seconds, inputs = timed(lambda: np.stack([backbone.preprocess(rgb) for rgb in images]))
    print(f"preprocessing of {options.images} images: {seconds:.2f} s, one thread", flush=True)

    def ours() -> np.ndarray:
        return np.concatenate([backbone.embed(inputs[at : at + BATCH]) for at in range(0, len(inputs), BATCH)])

    def theirs() -> np.ndarray:
        parts = []
        with torch.inference_mode():
            for at in range(0, len(inputs), BATCH):
                found = model.get_image_features(pixel_values=torch.from_numpy(inputs[at : at + BATCH]))
                parts.append(getattr(found, "pooler_output", found).numpy())
        return np.concatenate(parts)

    seconds, _ = timed(lambda: backbone.embed(inputs[:1]))
    print(f"compiling, and 16 images: {seconds:.2f} s", flush=True)
    theirs_first, _ = timed(lambda: model.get_image_features(pixel_values=torch.from_numpy(inputs[:16])))
    print(f"torch's first 16 images: {theirs_first:.2f} s", flush=True)
    best: dict[str, float] = {}
    found: dict[str, np.ndarray] = {}
    for _ in range(options.repeats):
        for name, call in (("ovibjax", ours), ("torch", theirs)):
            seconds, found[name] = timed(call)
            best[name] = min(seconds, best.get(name, seconds))
    for name, seconds in best.items():
        print(f"{name:8} {seconds:7.2f} s   {options.images / seconds:6.1f} images/s")
    norm = np.linalg.norm(found["torch"], axis=1, keepdims=True)
    print(f"largest difference: {np.abs((found['ovibjax'] - found['torch']) / norm).max():.1e}")
    print(f"ratio (torch / ovibjax): {best['torch'] / best['ovibjax']:.2f}")


if __name__ == "__main__":
    main()
