"""axe-core finds no serious or critical problem in any view of the pages, light or dark."""

import pytest

pytestmark = pytest.mark.browser

_VIEWS = (
    ("report", ""),  # the page of a run
    ("leaderboard", ""),
    ("leaderboard", "#benchmark=KITTI-FC&columns=weather&metric=cre"),
    ("leaderboard", "#model=raft"),
)


_FEWER = """for (const row of document.querySelectorAll(
    "tbody tr:nth-child(n + 3):not(:nth-last-child(-n + 2))")) row.remove();
for (const part of document.querySelectorAll("article, section, figure, .board"))
    if (!part.checkVisibility()) part.remove()"""


@pytest.mark.parametrize(("name", "state"), _VIEWS)
def test_pages_have_no_serious_accessibility_violation(visit, pages, serious_violations, name, state):
    """What the view hides and all but the first and last two rows of a table are removed: axe reads every element."""
    page = visit().page
    page.goto(pages[name].as_uri() + state)
    page.evaluate(_FEWER)
    for summary in page.locator("details > summary:visible").all():
        summary.click()
    assert serious_violations(page) == []
    page.emulate_media(color_scheme="dark")
    assert serious_violations(page, colours_alone=True) == []
