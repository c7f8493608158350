"""The command `ovibjax town`: the embedded town as pictures and files."""

from dataclasses import dataclass
from pathlib import Path

from ovibjax.errors import InputError
from ovibjax.runtime.progress import console


@dataclass(frozen=True)
class Town:
    """Draw the embedded town: a contact sheet, and on request frames in the released data set's folder layout."""

    out: Path
    """Folder for contact_sheet.png and the frames; made if missing."""
    frames: int = 0
    """Frames to write as rgb/ depth/ semantic/ metadata/ calibration/ (400 x 300, five cameras); none by default."""
    seed: int = 5
    """The town; another seed is another town."""
    style: int = 0
    """How it looks: façades, heights, trees, light; 0 is the default look."""
    route: int = 0
    """The drive through it."""

    def run(self) -> None:
        """Run the command."""
        from ovibjax.runtime.progress import progress_bar
        from ovibjax.world.town.files import check_drive, write_frames
        from ovibjax.world.town.layout import TownConfig
        from ovibjax.world.town.picture import contact_sheet

        for name, value in (("frames", self.frames), ("seed", self.seed), ("style", self.style), ("route", self.route)):
            if value < 0:
                raise InputError(f"--{name} {value} is negative")
        config = TownConfig(seed=self.seed, style=self.style)
        if self.frames:
            check_drive(self.out, config, self.frames, self.route)  # before the sheet of another town is drawn over
        try:
            self.out.mkdir(parents=True, exist_ok=True)
            with console.status("drawing the contact sheet"):
                contact_sheet(config, self.out / "contact_sheet.png")
        except OSError as error:
            raise InputError(
                f"{self.out}: cannot write there ({error.strerror}); choose another folder with --out"
            ) from error
        console.print(f"contact sheet: {self.out / 'contact_sheet.png'}")
        if self.frames:
            with progress_bar(f"writing {self.frames} frames", self.frames) as update:
                write_frames(config, self.out, self.frames, self.route, on_frame=lambda done, _: update(done))
            console.print(f"frames: {self.out}")
