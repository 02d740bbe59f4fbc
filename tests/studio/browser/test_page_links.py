"""Links into the studio from a page on disk, as a report is, and the file that the studio itself makes."""

from pathlib import Path

import pytest

pytest.importorskip("starlette")
from studio.live import studio

from farfield.vocabulary.studio import STUDIO_PORT, studio_link


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    with studio(notes=tmp_path_factory.mktemp("notes")) as running:
        yield running


def test_a_link_of_a_report_on_disk_opens_its_frame(chromium, live, tmp_path: Path):
    link = studio_link("kradar-1", "00006_00001").replace(f":{STUDIO_PORT}", f":{live.port}")
    (tmp_path / "report.html").write_text(f'<a href="{link}&test=1" rel="noreferrer">in the studio</a>')
    name, _, value = live.cookie.partition("=")
    context = chromium.new_context()
    cookie = {"name": name, "value": value, "url": live.origin, "sameSite": "Strict", "httpOnly": True}
    context.add_cookies([cookie])
    page = context.new_page()
    page.goto((tmp_path / "report.html").as_uri())
    page.click("a")
    page.wait_for_url("**/?frame=1*", timeout=30_000)
    page.wait_for_selector("#header:has-text('kradar')", timeout=30_000)
    assert "00006_00001" in page.inner_text("#header")
    context.close()


def test_a_stranger_with_the_link_is_not_let_in(chromium, live):
    context = chromium.new_context()
    page = context.new_page()
    answer = page.goto(live.origin + "/?frame=1")
    assert answer.status == 403
    assert "Press Enter in the terminal" in page.inner_text("body")
    context.close()


def test_another_page_cannot_open_the_socket(chromium, live, tmp_path: Path):
    (tmp_path / "evil.html").write_text("<title>evil</title>")
    context = chromium.new_context()
    name, _, value = live.cookie.partition("=")
    context.add_cookies([{"name": name, "value": value, "url": live.origin, "sameSite": "Strict"}])
    page = context.new_page()
    page.goto((tmp_path / "evil.html").as_uri())
    ended = page.evaluate(
        f"new Promise((done) => {{ const s = new WebSocket('ws://{live.host}/socket');"
        "s.onopen = () => done('open'); s.onerror = () => done('refused'); })"
    )
    assert ended == "refused"
    fetched = page.evaluate(f"fetch('{live.origin}/layer/0/0').then((a) => a.status, () => 'refused')")
    assert fetched == "refused"
    context.close()
