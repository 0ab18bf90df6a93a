"""A page as a browser shows it: headless Chromium, asked through a probe that the page carries in a copy."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from html import unescape
from pathlib import Path

import pytest

CHROMIUM = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None
)

#: Runs first in the page: collects errors; when everything is drawn, tells the page around it what it found.
PROBE = """<script>
(function () {
  const errors = [], was = console.error;
  console.error = (...all) => { errors.push(all.map(String).join(" ")); was.apply(console, all); };
  addEventListener("error", (e) => errors.push(String(e.message || e.type)));
  addEventListener("unhandledrejection", (e) => errors.push(String(e.reason)));
  function look() {
    const ids = [...document.querySelectorAll("[id]")].map((e) => e.id);
    const wide = [...document.querySelectorAll("main *")].filter((e) => {
      const box = e.getBoundingClientRect();
      // What stands in a table may scroll with it; what the table is called may not.
      const scrolls = e.closest(".scroll, svg, math") && !e.matches("caption > span");
      return box.width > 0 && box.left >= 0 && box.right > innerWidth + 1 && !scrolls;
    }).map((e) => e.tagName + "." + e.className + ": " + e.textContent.trim().slice(0, 40));
    const anchors = new Set(ids);
    // Of bars that share a scale, those whose length is not their share of the longest one's.
    const bars = [...document.querySelectorAll("td.adds .bar")]
      .map((e) => [parseFloat(e.style.width), e.getBoundingClientRect().width]).filter(([share, width]) => width > 2);
    const longest = bars.reduce((a, b) => (b[0] > a[0] ? b : a), [1, 0]);
    const uneven = bars.filter(([share, width]) => Math.abs(width / longest[1] - share / longest[0]) > 0.03);
    return {
      width: innerWidth, uneven, bars: bars.length,
      scroll: document.documentElement.scrollWidth, errors, wide: wide.slice(0, 5),
      twice: ids.filter((id, k) => ids.indexOf(id) !== k),
      dead: [...document.querySelectorAll('a[href^="#"]')].map((a) => a.getAttribute("href").slice(1))
        .filter((id) => !anchors.has(id)),
      plots: document.querySelectorAll(".plot").length,
      drawn: document.querySelectorAll('.plot[data-drawn="yes"]').length,
      paper: getComputedStyle(document.body).backgroundColor,
    };
  }
  addEventListener("load", () => {
    dispatchEvent(new Event("beforeprint"));
    let waited = 0;
    const again = setInterval(() => {
      const seen = look();
      waited += 1;
      if (seen.plots === seen.drawn || waited > 200) {
        clearInterval(again);
        setTimeout(() => parent.postMessage(JSON.stringify(look()), "*"), 300);
      }
    }, 100);
  });
})();
</script>
"""
FRAME = """<html><body><script>
addEventListener("message", (e) => {
  const told = document.createElement("pre"); told.textContent = e.data; document.body.append(told);
});
</script>"""
WINDOW = '<iframe src="page.html" style="width:%dpx;height:900px;border:0"></iframe>'


@dataclass(frozen=True)
class Seen:
    """What a browser ``width`` pixels wide showed; ``wide`` names elements that run off the page,
    ``uneven`` the share and the width of every bar that is not as long as it says."""

    width: int
    scroll: int
    errors: list[str]
    wide: list[str]
    twice: list[str]
    dead: list[str]
    plots: int
    drawn: int
    paper: str
    bars: int
    uneven: list[list[float]]


def look(html: str, widths: Sequence[int], dark: bool = False) -> dict[int, Seen]:
    """Open ``html`` in windows of ``widths`` pixels, draw everything, and look; skips where there is no Chromium."""
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine: the page is not looked at in a browser (apt-get install chromium)")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name:
        folder = Path(name)
        (folder / "page.html").write_text(html.replace("<head>", "<head>" + PROBE, 1), "utf-8")
        (folder / "frame.html").write_text(FRAME + "".join(WINDOW % width for width in widths), "utf-8")
        command = [
            CHROMIUM, "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
            f"--user-data-dir={folder / 'profile'}", "--window-size=1300,2000", "--virtual-time-budget=30000",
            f"--blink-settings=preferredColorScheme={0 if dark else 1}", "--dump-dom",
            f"file://{folder / 'frame.html'}",
        ]  # fmt: skip
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    told = [Seen(**json.loads(unescape(text))) for text in re.findall(r"<pre>(.*?)</pre>", done.stdout, re.DOTALL)]
    assert sorted(seen.width for seen in told) == sorted(widths), f"the page told too little: {done.stderr[-600:]}"
    return {seen.width: seen for seen in told}
