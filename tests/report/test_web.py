"""Pages as text: one file, everything escaped, every link leads somewhere. `test_browser` opens them."""

import base64
import hashlib
import io
import json
import re
from html.parser import HTMLParser
from importlib import resources

import numpy as np
import pytest
from PIL import Image

from ovibjax.errors import InputError
from ovibjax.report.claims import Interval
from ovibjax.report.comparison import Pair
from ovibjax.report.web.pictures import MOST_WIDE_PX, embedded, without_pictures
from ovibjax.report.web.results_html import write_results_page
from ovibjax.report.web.studies import TableStudy
from ovibjax.report.web.sweep_html import write_sweep_page
from tests.report.cases import made_results, zipped
from tests.report.folders import EVIL, PARTS, figure, write_results

STUDY = TableStudy("one", "One", ("k",), {"error_m": "error (m)"}, repetition="")
PAIRS = [Pair("one", "error", "m", 2.0, Interval(4.0, 0.5)), Pair("two", "count", "", 3.0, Interval(0.0, np.inf))]


class Page(HTMLParser):
    """Addresses, names and texts of a page."""

    def __init__(self, html):
        super().__init__()
        self.ids, self.links, self.loaded, self.words, self.inside = [], [], [], [], ""
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.inside = tag
        self.ids += [attributes["id"]] if "id" in attributes else []
        if tag == "a":
            self.links.append(attributes["href"])
        self.loaded += [attributes[key] for key in ("src", "srcset", "data", "action") if key in attributes]
        self.loaded += [attributes["href"]] if tag == "link" else []

    def handle_data(self, data):
        if self.inside not in ("script", "style"):
            self.words.append(data)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = write_results(tmp_path_factory.mktemp("results"))
    rows = [{"k": str(k), "error_m": str(1 / k)} for k in (1, 2, 4)]
    return write_results_page(folder, PARTS, [STUDY.study(rows)], PAIRS, [f"About {EVIL}"]).read_text()


@pytest.fixture(scope="module")
def sweep(tmp_path_factory):
    path = tmp_path_factory.mktemp("runs") / "mine.html"
    return write_sweep_page(
        made_results(), path, f"mine {EVIL}", about={"settings": {"steps": 3, "k": [1, 2]}}
    ).read_text()


@pytest.fixture(params=["results", "sweep"])
def html(request):
    return request.getfixturevalue(request.param)


def test_a_page_needs_no_other_file(html):
    page = Page(html)
    assert all(address.startswith("data:") for address in page.loaded) and page.loaded
    assert all(link.startswith("#") for link in page.links) and page.links
    assert "default-src 'none'" in html and "@import" not in html and "url(" not in html.split("</style>")[0]


def test_links_lead_to_one_place(html):
    page = Page(html)
    assert len(set(page.ids)) == len(page.ids)
    assert {link[1:] for link in page.links} <= set(page.ids)


def test_texts_are_escaped(html):
    assert html.count("<script>alert") == 0 and EVIL in "".join(Page(html).words)
    assert html.count("</script>") == html.count("<script")


def test_data_can_be_read_back(html):
    (data,) = re.findall(r'<script type="application/json" id="studies">(.*?)</script>', html, re.DOTALL)
    for study in json.loads(data):
        assert len(study["points"]) == len(study["axes"]) and len(study["count"]) == len(study["points"][0])


def test_claims_stand_in_the_order_of_the_parts_with_their_rules(results):
    rows = re.findall(r'<tr id="([\w-]+)" data-verdict="([\w-]+)" data-own="(\w+)" data-part="([\w-]+)"', results)
    assert len(rows) == 32 and rows[0][0] == "one-1" and rows[0][3] == "second-part"
    assert rows[30] == ("two-1", "held", "ours", "first-part") and rows[31][1] == "says-nothing-here"
    assert all(f"rule {i}</details>" in results for i in range(1, 30))


def test_pairs_are_drawn_where_there_is_a_ratio(results):
    low, mean, high = PAIRS[0].span()
    assert PAIRS[0].ratio == 2 and low < mean < high and mean == pytest.approx(0.5 + 0.5 * np.log10(2))
    assert PAIRS[1].ratio is None and PAIRS[1].span() is None
    assert results.count('class="strip"') == 1
    assert Pair("", "", "", 1.0, Interval(1e3, 999.0)).span() == (0.5, 1.0, 1.0)


def test_provenance_is_short_and_long_tables_are_named(results):
    assert "100 to 102" in results and "train 2.0 (1.0 of them compiling)" in results
    assert "<code>one/long.csv</code>, beside this page: 100 rows" in results
    assert results.count("<img ") == 3 and "Contact sheet" in results


def test_a_sweep_tells_what_is_missing_and_its_settings(sweep):
    words = "".join(Page(sweep).words)
    assert "60 members" in words and "6 diverged, 1 unfinished" in words
    assert "settings.steps" in words and "Not every member counts" in words


def test_best_points_are_those_of_best(sweep):
    row = re.search(r"<tr><th scope=\"row\">mean_m \(m\)</th><td>lowest</td>(.*?)</tr>", sweep, re.DOTALL)
    assert "beta = 0.01, gamma = 0.1, prefix = 35" in row[1] and "0.520 ±" in row[1]


def test_zipped_axes_and_one_metric(tmp_path):
    html = write_sweep_page(zipped(made_results()), tmp_path / "z.html", "z", "latency").read_text()
    assert "beta / gamma" in html and "Without effects here: mean_m, loss" in html


def test_nothing_to_show_is_refused(tmp_path):
    with pytest.raises(InputError, match="nothing to show"):
        write_sweep_page(made_results()[["finished", "diverged"]], tmp_path / "x.html", "x")
    with pytest.raises(InputError, match=r"cannot write there"):
        (tmp_path / "file").write_text("")
        write_sweep_page(made_results(), tmp_path / "file" / "x.html", "x")


def test_libraries_are_those_that_are_named():
    vendor = resources.files("ovibjax.report.web") / "vendor"
    listed = re.findall(r"`([\w.]+\.js)` \| ([\d.]+) \| ISC \| ([0-9a-f]{64})", (vendor / "README.md").read_text())
    assert len(listed) == 2
    for name, version, digest in listed:
        content = (vendor / name).read_bytes()
        assert hashlib.sha256(content).hexdigest() == digest and f"v{version} ".encode() in content[:100], name


def test_pictures_are_small_and_look_alike(tmp_path):
    figure(tmp_path / "wide.png", (2400, 1200))
    picture = embedded(tmp_path / "wide.png")
    assert (picture.width, picture.height) == (MOST_WIDE_PX, MOST_WIDE_PX // 2)
    with Image.open(io.BytesIO(base64.b64decode(picture.uri.partition(",")[2]))) as image:
        shown = np.asarray(image.convert("RGB"), float)
    with Image.open(tmp_path / "wide.png") as image:
        meant = np.asarray(image.resize(shown.shape[1::-1], Image.Resampling.LANCZOS), float)
    assert np.abs(shown - meant).mean() < 4
    assert without_pictures(f'<img src="{picture.uri}">') == '<img src="data:image/webp;base64,">'
    (tmp_path / "bad.png").write_bytes(b"no picture")
    with pytest.raises(InputError, match=r"bad.png: not a picture"):
        embedded(tmp_path / "bad.png")
