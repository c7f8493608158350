"""Pages in a real browser: figures load, filters and keys work, contrast suffices, phones do not scroll sideways."""

from pathlib import Path

import pytest

from ovibjax.report.web.results_html import write_results_page
from ovibjax.report.web.studies import TableStudy
from ovibjax.report.web.sweep_html import write_sweep_page
from tests.report.browsers import opened_browser
from tests.report.cases import made_results, zipped
from tests.report.folders import PARTS, write_results
from tests.report.test_web import PAIRS

pytestmark = pytest.mark.browser
playwright = pytest.importorskip("playwright.sync_api")
COMMITTED = Path(__file__).parents[2] / "results" / "index.html"


@pytest.fixture(scope="module")
def browser():
    try:
        with opened_browser() as found:
            yield found
    except playwright.Error as error:
        pytest.skip(f"no browser here: {str(error).splitlines()[0]}")


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """A made results page, a made sweep page, and the committed one."""
    folder = write_results(tmp_path_factory.mktemp("results"))
    rows = [
        {"rule": rule, "k": str(k), "seed": str(seed), "error_m": f"{(1 + seed) / k:.4f}"}
        for rule in ("fifo", "edf")
        for k in (1, 2, 4, 64)
        for seed in range(3)
    ]
    spec = TableStudy("one", "One", ("rule", "k"), {"error_m": "error (m)"}, start={"x": "k", "lines": "rule"})
    made = write_results_page(folder, PARTS, [spec.study(rows)], PAIRS)
    sweep = write_sweep_page(made_results(), tmp_path_factory.mktemp("runs") / "mine.html", "mine")
    return {"results": made, "sweep": sweep, "committed": COMMITTED}


@pytest.fixture
def opened(browser, pages):
    """Opens a page by name at a width; at the end nothing must have been complained of or asked of a network."""
    complaints, contexts = [], []

    def go(name, width=1280):
        context = browser.new_context(viewport={"width": width, "height": 900}, bypass_csp=False)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on(
            "request", lambda asked: asked.url.startswith(("file:", "data:", "blob:")) or complaints.append(asked.url)
        )
        page.goto(pages[name].as_uri())
        page.wait_for_selector("#explorer svg")
        return page

    yield go
    for context in contexts:
        context.close()
    assert complaints == []


EVERY = pytest.mark.parametrize("name", ["results", "sweep", "committed"])


@EVERY
@pytest.mark.parametrize("width", [375, 768, 1280])
def test_nothing_is_wider_than_the_screen(opened, name, width):
    page = opened(name, width)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.evaluate("document.querySelectorAll('details').forEach((part) => { part.open = true; })")
    assert page.evaluate("document.documentElement.scrollWidth") <= width


@EVERY
def test_figures_load(opened, name):
    sizes = opened(name).evaluate("[...document.images].map((image) => image.complete && image.naturalWidth)")
    assert all(size > 300 for size in sizes) and (sizes or name == "sweep")


@EVERY
@pytest.mark.parametrize("width", [375, 1280])
def test_contrast_names_and_roles_suffice(browser, pages, name, width):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    with browser.new_context(viewport={"width": width, "height": 900}, bypass_csp=True) as context:
        page = context.new_page()
        page.goto(pages[name].as_uri())
        page.wait_for_selector("#explorer svg")
        page.evaluate("document.querySelectorAll('details').forEach((part) => { part.open = true; })")
        found = axe.run(page)
    assert found.violations_count == 0, found.generate_report()


def shown(page):
    return page.eval_on_selector_all("#claims-table tbody tr", "rows => rows.filter((r) => !r.hidden).map((r) => r.id)")


def test_filters_keep_what_fits(opened):
    page = opened("results")
    assert len(shown(page)) == 24
    page.get_by_role("button", name="Show all 32").click()
    assert len(shown(page)) == 32
    page.get_by_role("button", name="not held", exact=True).click()
    assert shown(page) == [f"one-{i}" for i in range(3, 31, 4)]
    page.get_by_role("button", name="held on average").click()
    assert len(shown(page)) == 15
    page.get_by_label("Words").fill("statement 10")
    assert shown(page) == ["one-11"] and "1 of 32" in page.locator("#claims-shown").inner_text()
    page.get_by_role("button", name="Show all", exact=True).click()
    page.get_by_role("button", name="ours (1)").click()
    assert shown(page) == ["two-1"]
    page.get_by_label("Part").select_option("Second part")
    assert shown(page) == []
    page.goto(page.url.partition("#")[0] + "#one-28")
    assert "one-28" in shown(page)


def test_tables_sort_by_number_and_back(opened):
    page = opened("results")
    page.locator("section#one summary", has_text="small.csv").click()
    table = page.get_by_role("region", name="Table one/small.csv")
    first = "rows => rows.map((row) => row.cells[1].textContent)"
    for expected in (["9", "10", "-"], ["10", "9", "-"]):
        table.get_by_role("button", name="error_m").click()
        assert table.locator("tbody tr").evaluate_all(first) == expected
    assert table.locator("th[aria-sort=descending]").count() == 1


def test_arrow_keys_and_the_pointer_tell_values_and_intervals(opened):
    page = opened("results")
    page.locator("[data-role=chart]").focus()
    told = page.locator("[data-role=told]")
    page.keyboard.press("ArrowRight")
    playwright.expect(told).to_have_text("rule fifo, k 1; error (m): 2.0 ± 2.5; 3 seeds")
    page.keyboard.press("ArrowLeft")
    playwright.expect(told).to_contain_text("rule edf, k 64")
    page.locator("#explorer svg circle").nth(1).hover(force=True)
    playwright.expect(told).to_contain_text("k 2; error (m): 1.0 ± 1.2")


CHOSEN = "select => select.selectedOptions[0].textContent"


def choice(page, label):
    """The select of the explorer with a label."""
    return page.locator("#explorer label", has_text=label).locator("select").first


def test_the_explorer_follows_its_choices(opened):
    page = opened("sweep")
    choice(page, "Study").select_option("mean_m")
    for label, option in (("Along", "prefix"), ("A line per", "beta (1/bit)"), ("As", "heat map")):
        choice(page, label).select_option(option)
    assert page.locator("#explorer svg rect").count() == 4  # at gamma 1 all members at beta 0.1 diverged
    with page.expect_download() as download:
        page.get_by_role("button", name="Save every point as CSV").click()
    lines = Path(download.value.path()).read_text().splitlines()
    assert len(lines) == 25 and lines[0] == "beta,gamma,prefix,mean_m,mean_m_half,members"


def test_points_that_advance_together_are_scattered(opened, pages, tmp_path):
    pages["search"] = write_sweep_page(zipped(made_results()), tmp_path / "search.html", "search", "latency")
    page = opened("search")
    for label, option in (("Along", "gamma"), ("A line per", "beta (1/bit)"), ("As", "colours")):
        choice(page, label).select_option(option)
    assert page.locator("#explorer svg circle").count() == 3
    assert page.locator("[data-role=controls] select").count() == 3


def test_an_interaction_leads_to_its_chart(opened, pages, tmp_path):
    complete = write_sweep_page(made_results().isel(beta=[0, 1]), tmp_path / "two.html", "two")
    pages["two"] = complete
    page = opened("two")
    row = page.locator("tr", has_text="gamma × prefix").first
    row.get_by_role("link", name="see it drawn").click()
    assert [choice(page, label).evaluate(CHOSEN) for label in ("A line per", "Along")] == ["gamma", "prefix"]


@EVERY
def test_the_keyboard_reaches_everything(opened, name):
    page = opened(name)
    wanted = page.evaluate(
        "[...document.querySelectorAll('a[href], button, select, input, summary, [tabindex=\"0\"]')]"
        ".filter((part) => part.checkVisibility() && !part.disabled).length"
    )
    reached = 0
    for _ in range(wanted + 20):
        page.keyboard.press("Tab")
        tag = page.evaluate("document.activeElement.tagName")
        if tag == "BODY":
            break
        reached += 1
    assert reached >= wanted


def test_paper_gets_every_claim_and_rule(opened):
    page = opened("results")
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    page.emulate_media(media="print")
    assert len(shown(page)) == 32 and "rule 29" in page.locator("#one-30 details").inner_text()
    assert not page.get_by_role("navigation").is_visible()
    page.evaluate("dispatchEvent(new Event('afterprint'))")
    assert len(page.pdf()) > 10_000
