"""The command `ovibjax features`: somebody's images and poses to a feature file."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from ovibjax.features.backbones.by_name import BackboneOptions
from ovibjax.runtime.progress import console, progress_bar

if TYPE_CHECKING:
    from ovibjax.features.images.source import OnStep, Skipped

_NAMED = 20  # frames named per reason; the counts are complete


@dataclass(frozen=True)
class Features:
    """Turn images with poses into a feature file, which `ovibjax reproduce --data` and `replay --data` take.

    SRC is one of

    - a folder: rgb/<Camera>/<frame>.png (or .jpg, .webp, .bmp) and metadata/<frame>.json, or a folder of such towns;

    - an archive: the same as .tar, .tar.gz or .zip, read in place, or .tar.bz2, .tar.xz or .tar.zst (extra [zstd]),
    unpacked into a temporary file;

    - a table: .csv, .tsv or .txt with columns frame,x_m,y_m,z_m,yaw_deg (or yaw_rad, or qw,qx,qy,qz), optionally
    scene and context, together with --images;

    - poses as TUM, KITTI, EuRoC, AirSim or COLMAP keep them, together with --images.

    Cameras are Front Back Left Right and, for a UAV, Down. Images may be of any size.

    Positions and yaw stay in the axes of the data unless --axes says which these are: yaw is measured from x towards y,
    so that (cos yaw, sin yaw) is the heading in CARLA's left-handed axes as well as in right-handed ones.

    Finished batches are kept in FILE.npz.partial/: after Ctrl-C, a crash or a kill, the same command goes on there and
    ends with the same bytes.

    Example: ovibjax features my.csv --images 'images/{view}/{frame}.jpg' --out mine.npz
    """

    src: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SRC")]
    """A folder, an archive, or a file of poses."""
    out: Path
    """The .npz file to write."""
    backbone: str = "embedded"
    """Image encoder: embedded, clip (ViT-B/32 from the model cache), clip:FOLDER, clip:OWNER/NAME or onnx:FILE."""
    images: str | None = None
    """For poses: where images lie, relative to their file: {view} or {view:lower}, {frame} or {frame:06d}, {scene}, and
    {file}, what the table's column of the view says, are filled in. AirSim: 'images/{file}' with
    --cameras Front=0 Back=4 ... takes each camera's photo from ImageFile; or 'images/img_{view}_{frame}.jpg'."""
    cameras: tuple[str, ...] = ()
    """What views are called in the data, where not Front Back Left Right Down: Front=cam0 Back=rear."""
    poses: str | None = None
    """Form of a file of poses, where it is not recognised: table, tum, kitti, euroc, airsim or colmap."""
    columns: tuple[str, ...] = ()
    """Which columns of a table are meant: frame=id x_m=x y_m=y z_m=z yaw_deg=yaw."""
    order: str | None = None
    """The column of a table that its frames are put in order by, numbers or dates; by default a column time, time_s or
    timestamp, or else the table's own order."""
    axes: str | None = None
    """Which way x, y and z of the poses point, for the world and, after a slash, the body: three of f b l r u d, or of
    e w n s u d. ned; enu/rdf is a camera looking along z; rdf is KITTI, whose poses come out with x forward and z
    up; lat-lon-alt are degrees, and yaw then a compass bearing (lon-lat-alt: from east towards north)."""
    views: Literal[4, 5] | None = None
    """5 (UAV) or 4 (UGV: without Down); by default 5 where there are images of Down."""
    strict: bool = False
    """Refuse frames that lack a view or a pose or do not decode, instead of leaving them out."""
    bits: int | None = None
    """Bits that images of 16 bits per channel really have, such as 12; by default what the file says, or 16."""
    batch: int = 16
    """Frames per call of the encoder; memory grows with it, and another value is another extraction."""
    # The default is frozen, so that instances may share it.
    onnx: tyro.conf.OmitArgPrefixes[BackboneOptions] = BackboneOptions()  # noqa: RUF009
    """What an `onnx:FILE` network expects, where its side file does not say so."""

    def run(self) -> None:
        """Run the command."""
        from ovibjax.features.images.by_path import open_source
        from ovibjax.features.images.extraction import check_out, extract
        from ovibjax.features.images.pose_table import PoseOptions
        from ovibjax.features.sequence import sequence_of
        from ovibjax.features.splits import MIN_FRAMES

        check_out(self.out)
        with _steps() as on_step:
            options = PoseOptions(self.poses, self.columns, self.axes, self.order)
            source = open_source(self.src, self.images, self.views, on_step, options, self.cameras)
        if source.form:
            _say(f"poses: {self.src}: {source.form}")
        try:
            with console.status("opening the encoder"):
                from ovibjax.features.backbones.by_name import open_backbone

                backbone = open_backbone(self.backbone, self.onnx)
            description = f"{len(source.frames)} frames through {backbone.name}"
            with progress_bar(description, len(source.frames), transient=True) as update:
                done = extract(source, backbone, self.out, self.batch, self.strict, update, self.bits)
        finally:
            source.close()
        skipped = (*source.skipped, *done.failed)
        _print_skipped(skipped)
        n, views, dim = done.features.features.shape
        again = f" ({done.resumed} of them from the interrupted run)" if done.resumed else ""
        _say(f"kept {n} of {n + len(skipped)} frames{again}; axes: {source.axes}")
        _say(f"features: {self.out} [{n}, {views}, {dim}]")
        over = "; what was left out is passed in one step" if skipped else ""
        _say(f"order: {sequence_of(done.features.positions_m, done.features.scene_id).line()}{over}")
        if n < MIN_FRAMES:
            _say(f"note: ovibjax reproduce needs at least {MIN_FRAMES} frames")


@contextmanager
def _steps() -> Iterator["OnStep"]:
    """One bar after the other, each shown from its first report."""
    with ExitStack() as stack:
        shown: dict[str, Callable[..., None]] = {}

        def on_step(description: str, done: int, total: int) -> None:
            if description not in shown:
                stack.close()  # only one bar can move at a time
                shown[description] = stack.enter_context(progress_bar(description, total, transient=True))
            shown[description](done, total)

        yield on_step


def _print_skipped(skipped: tuple["Skipped", ...]) -> None:
    groups: dict[str, list[Skipped]] = {}
    for one in skipped:
        groups.setdefault(one.reason, []).append(one)
    for reason, cases in groups.items():
        _say(f"skipped {len(cases)}, {reason}:")
        for one in cases[:_NAMED]:
            _say(f"  {one.frame_id}: {one.detail}")
        if len(cases) > _NAMED:
            _say(f"  and {len(cases) - _NAMED} more")


def _say(text: str) -> None:
    # Names are somebody else's: no markup, and no line breaks that the name does not have.
    console.print(text, markup=False, highlight=False, soft_wrap=True)
