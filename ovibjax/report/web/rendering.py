"""A page from its template: styles, scripts and data stand inside it, and it asks nothing of any network."""

import json
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

import ovibjax
from ovibjax.errors import InputError
from ovibjax.report.cells import cells

_SCRIPTS = {
    "filters": ("assets/page.js",),
    "charts": ("assets/page.js", "vendor/d3.min.js", "vendor/plot.umd.min.js", "assets/explorer.js"),
}


def render(template: str, scripts: str = "charts", **context: Any) -> str:
    """Render a page.

    Args:
        template: its name among the templates.
        scripts: `filters`, or `charts` for what draws as well.
        context: what the template shows.

    Returns:
        HTML, one document; texts are escaped.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("ovibjax.report.web", "templates"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    # Without spaces, and with NaN refused: a browser reads none.
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "allow_nan": False, "ensure_ascii": False}
    environment.policies["json.dumps_function"] = json.dumps
    environment.filters["figures"] = lambda value, digits=3: f"{value:.{digits}g}"
    environment.filters["interval"] = lambda span: cells(np.array([span.mean]), np.array([span.half]))[0]
    environment.filters["slug"] = slug
    inside = {
        "style": asset("assets/page.css"),
        "scripts": [asset(name) for name in _SCRIPTS[scripts]],
        "version": ovibjax.__version__,
    }
    return environment.get_template(template).render(**inside, **context)


def asset(name: str) -> str:
    """Text of a file that pages hold."""
    return resources.files("ovibjax.report.web").joinpath(*name.split("/")).read_text(encoding="utf-8")


def slug(text: str) -> str:
    """A text as part of an address: `says nothing here` as `says-nothing-here`."""
    return "".join(letter if letter.isalnum() else "-" for letter in text.lower())


def write(path: Path, html: str) -> Path:
    """Write a page.

    Raises:
        InputError: the disk refuses.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(html, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot write there ({error.strerror}); choose another place") from error
    return path
