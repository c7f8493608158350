"""A small folder of results, as the pages are tested on."""

import json

from PIL import Image, ImageDraw

from ovibjax.report.claims import HELD, NOT_HELD, ON_AVERAGE, REPORTED, Claim, write_claims

PARTS = {"Second part": ("one",), "First part": ("two",)}
EVIL = "<script>alert('x')</script> & \"k\" | <b>"


def figure(path, size=(400, 300)):
    """A drawing with few colours and many edges."""
    image = Image.new("RGB", size, "white")
    draw = ImageDraw.Draw(image)
    for x in range(0, size[0], 10):
        draw.line((x, 0, size[0] - x, size[1]), fill=(0, 114, 178), width=2)
    image.save(path)


def write_results(folder, claims=30):
    """Two figures; `claims` statements by the first, of every verdict, one of them with all that must be escaped."""
    verdicts = (HELD, ON_AVERAGE, NOT_HELD, REPORTED)
    made = [Claim(f"statement {i}", f"{i} m", f"{i}.5 ± 0.1 m", verdicts[i % 4], f"rule {i}") for i in range(claims)]
    made[0] = Claim(EVIL, EVIL, "1 | 2", HELD, EVIL)
    other = [Claim("of the project", "-", "2", HELD, "rule").as_own(), Claim.silent("premise", "-", "2", "rule")]
    for name, said in (("one", made), ("two", other)):
        (folder / name).mkdir(parents=True)
        write_claims(folder / name / "claims.json", said)
        facts = {"title": f"Figure {name}", "caption": f"What {name} shows.", "preset": "smoke", "seeds": "100 101 102"}
        facts |= {"commit": "0123abc", "seconds": 3, "stages": {"train": 2.0}, "compile": {"train": 1.0}}
        (folder / name / "provenance.json").write_text(json.dumps(facts))
        figure(folder / name / "figure.png")
    (folder / "one" / "small.csv").write_text('name,error_m\n"a, b",10\n"c|d",9\ne,-\n')
    (folder / "one" / "long.csv").write_text("k,error_m\n" + "".join(f"{k},{k / 7:.3f}\n" for k in range(100)))
    (folder / "extra").mkdir()
    figure(folder / "extra" / "contact_sheet.png")
    return folder
