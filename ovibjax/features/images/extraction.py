"""Images to features: frames of a source through a backbone Φ in batches, kept on disk as they come."""

import hashlib
import itertools
import warnings
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np
import PIL
from numpy.typing import NDArray
from PIL import Image

import ovibjax
from ovibjax.errors import InputError, StrPath, refusal
from ovibjax.features import backbones
from ovibjax.features.backbones.by_name import Backbone
from ovibjax.features.feature_files import save
from ovibjax.features.frames import FeatureSet, OnFrames, make_feature_set
from ovibjax.features.images.decoding import BITS, decode_image
from ovibjax.features.images.journal import Journal
from ovibjax.features.images.source import MAX_IMAGE_BYTES, Frame, Skipped, Source, describe_skipped, nothing_left
from ovibjax.runtime.cache import source_code
from ovibjax.runtime.threads import in_order

BATCH_FRAMES = 16
"""Frames per call of the backbone, 80 images for a UAV."""
_BATCHES_AHEAD = 2  # decoded images waiting; CLIP's inputs take 50 MB a batch
_BACKBONES = sorted(path.stem for path in Path(backbones.__file__).parent.glob("*.py"))
_SOURCES = (
    *("features.images.decoding", "features.images.extraction"),
    *(f"features.backbones.{name}" for name in _BACKBONES),
)


@dataclass(frozen=True)
class Extraction:
    """What came of an extraction.

    Attributes:
        features: the set as saved.
        failed: frames left out because an image did not decode or had no feature.
        resumed: frames that an earlier, interrupted run had finished.
    """

    features: FeatureSet
    failed: tuple[Skipped, ...]
    resumed: int


def partial_folder(out: StrPath) -> Path:
    """Where an unfinished extraction keeps its batches: beside the file to be."""
    return Path(out).with_name(Path(out).name + ".partial")


def check_out(out: StrPath) -> None:
    """Refuse, before any work, a file that cannot be written in the end.

    Raises:
        InputError: not an `.npz`, a folder, or its folder is missing.
    """
    out = Path(out)
    if out.suffix != ".npz":
        raise refusal(out, "the feature file must end in .npz")
    try:
        if out.is_dir() or not out.parent.is_dir():
            raise refusal(out, "is a folder" if out.is_dir() else "its folder does not exist; create it first")
    except (OSError, ValueError) as error:
        raise refusal(out, f"cannot be written ({error})") from error


def extract(
    source: Source,
    backbone: Backbone,
    out: StrPath,
    batch: int = BATCH_FRAMES,
    strict: bool = False,
    on_frames: OnFrames | None = None,
    bits: int | None = None,
) -> Extraction:
    """Write the features of a source to an `.npz` file (paper, Section "Task-Oriented Feature Extraction").

    Batches are cut by the frame's place in the source, and kept in a folder beside `out` as they are finished: after a
    crash or a kill, the same call goes on there and ends with the same bytes. The folder goes when the file is written.

    Args:
        source: frames, at least one.
        backbone: the encoder Φ.
        out: the file to write or replace.
        batch: frames per call of the backbone.
        strict: refuse a frame that is incomplete or does not decode, instead of leaving it out.
        on_frames: called with (frames done, frames in all).
        bits: see `decode_image`.

    Returns:
        What was written and what was left out.

    Raises:
        InputError: `out` cannot be written, its folder holds another unfinished extraction, no frame is left, or, if
            strict, any was left out.
        KeyboardInterrupt: Ctrl-C; the message says what is kept.
    """
    check_out(out)
    if batch < 1:
        raise InputError(f"--batch {batch} is not positive")
    if bits is not None and bits not in BITS:
        raise InputError(f"--bits {bits}: a channel of 16 bits has {BITS[0]} to {BITS[-1]} of its own")
    if strict and source.skipped:
        raise refusal(source.name, f"{_count(source.skipped)} incomplete: {describe_skipped(source.skipped)}")
    config = _config(source, backbone, batch) | ({} if bits is None else {"--bits": bits})
    # Pillow warns of images that are refused anyway.
    with warnings.catch_warnings(), Journal(partial_folder(out), config) as journal:
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        resumed = min(journal.batches * batch, len(source.frames))
        try:
            _run(source, backbone, batch, strict, journal, on_frames, bits)
        except KeyboardInterrupt:
            done = min(journal.batches * batch, len(source.frames))
            kept = f"{done} of {len(source.frames)} frames are kept in {journal.folder}: repeat the command to go on"
            raise KeyboardInterrupt(f"interrupted; {kept if done else 'nothing was written'}") from None
        if not journal.rows:
            journal.remove()
            raise nothing_left(source.name, (*source.skipped, *journal.failed))
        made = _feature_set(source, journal)
        save(out, made)
        journal.remove()
    return Extraction(made, tuple(journal.failed), resumed)


def _count(skipped: tuple[Skipped, ...] | list[Skipped]) -> str:
    return f"{len(skipped)} frame{'s' if len(skipped) > 1 else ''}"


def _run(
    source: Source,
    backbone: Backbone,
    batch: int,
    strict: bool,
    journal: Journal,
    on_frames: OnFrames | None,
    bits: int | None,
) -> None:
    """Finish the batches that the journal lacks."""
    n = len(source.frames)

    def load(frame: Frame) -> list[NDArray[np.float32]] | Skipped:
        return _load(source, backbone, frame, bits)

    _refuse_failed(source, strict, journal.failed)
    decoded = in_order(load, source.frames[journal.batches * batch :], _BATCHES_AHEAD * batch)
    try:
        for start in range(journal.batches * batch, n, batch):
            loaded = list(itertools.islice(decoded, batch))
            kept, features, failed = _embed(source, backbone, start, batch, loaded)
            _refuse_failed(source, strict, failed)
            journal.append(kept, features, failed)
            if on_frames is not None:
                on_frames(start + len(loaded), n)
    finally:
        decoded.close()  # type: ignore[attr-defined]  # a generator


def _refuse_failed(source: Source, strict: bool, failed: list[Skipped]) -> None:
    if strict and failed:
        raise refusal(source.name, f"{_count(failed)} refused: {describe_skipped(failed)}")


def _load(source: Source, backbone: Backbone, frame: Frame, bits: int | None) -> list[NDArray[np.float32]] | Skipped:
    """The backbone's inputs of one frame, or why there are none."""
    inputs = []
    for image, size in zip(frame.images, frame.sizes_bytes, strict=True):
        try:
            if size > MAX_IMAGE_BYTES:
                raise ValueError(f"{size} bytes, over {MAX_IMAGE_BYTES}")
            inputs.append(backbone.preprocess(decode_image(source.read(image), bits)))
        except ValueError as error:  # InputError among them
            return Skipped(frame.frame_id, "an image does not decode", f"{image}: {error}")
    return inputs


def _embed(
    source: Source,
    backbone: Backbone,
    start: int,
    batch: int,
    loaded: list[list[NDArray[np.float32]] | Skipped],
) -> tuple[list[int], NDArray[np.float32], list[Skipped]]:
    """Rows with features, the features [rows, M, d], and the frames without."""
    failed = [one for one in loaded if isinstance(one, Skipped)]
    good = [one for one in loaded if not isinstance(one, Skipped)]
    n_views = len(source.frames[0].images)
    if not good:
        return [], np.empty((0, n_views, 0), np.float32), failed
    # Always a full batch, each frame at its place: one size is compiled, and no bit depends on what else is there.
    blank = [np.zeros_like(one) for one in good[0]]
    full = [blank if isinstance(one, Skipped) else one for one in loaded] + [blank] * (batch - len(loaded))
    flat = backbone.embed(np.stack([image for views in full for image in views]))
    if flat.ndim != 2 or len(flat) != batch * n_views:
        raise InputError(f"backbone {backbone.name}: features of shape {flat.shape} for {batch * n_views} images")
    features = flat.astype(np.float32, copy=False).reshape(batch, n_views, -1)
    usable = np.isfinite(features).all(axis=-1) & (features != 0).any(axis=-1)
    kept = []
    for row, one in enumerate(loaded):
        if isinstance(one, Skipped):
            continue
        frame = source.frames[start + row]
        if usable[row].all():
            kept.append(row)
        else:
            image = frame.images[int(np.argmin(usable[row]))]
            failed.append(Skipped(frame.frame_id, "an image has no feature", f"{image}: zero or not finite"))
    return [start + row for row in kept], features[kept], failed


def _config(source: Source, backbone: Backbone, batch: int) -> dict[str, str | int]:
    """Everything the features depend on, by the name it has for the user."""
    listing = hashlib.sha256()
    for frame in source.frames:
        listing.update(repr(frame).encode("utf-8", "backslashreplace"))
    code = hashlib.sha256(f"{ovibjax.__version__} {PIL.__version__} {version('jax')}".encode() + source_code(*_SOURCES))
    return {
        "frames": len(source.frames),
        "views": len(source.frames[0].images),
        "images and poses": listing.hexdigest()[:16],
        "backbone": backbone.name,
        "weights or preprocessing": backbone.fingerprint[:16],
        "--batch": batch,
        "software version": code.hexdigest()[:16],
    }


def _feature_set(source: Source, journal: Journal) -> FeatureSet:
    frames = [source.frames[row] for row in journal.rows]
    scenes = {scene: number for number, scene in enumerate(sorted({frame.scene for frame in source.frames}))}
    return make_feature_set(
        journal.features(),
        np.array([frame.position_m for frame in frames]),
        yaw_rad=np.array([frame.yaw_rad for frame in frames]),
        context=np.array([frame.context for frame in frames]),
        scene_id=np.array([scenes[frame.scene] for frame in frames]),
        frame_id=np.array([frame.frame_id for frame in frames]),
        source=source.name,
    )
