"""Draw the pictures of docs/explore.md: python docs/explore.py, by Playwright in the Chromium of the system."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

ROOT = Path(__file__).parents[1]
PICTURES = ROOT / "docs" / "_static"
DATA = ROOT / "examples" / "data" / "lammps_plane_shear"
FILES = ["particles.*.dump.gz", "-c", "contacts.*.dump.gz", "--frozen", "2"]
COMMAND = [sys.executable, "-m", "xcg.cli", "explore", *FILES, "--no-browser"]
ROOM = 12  # pixels around what is drawn
# right and lower end of all that the page shows, also inside of the elements of Panel
EXTENT = """() => {
  let [right, lower] = [0, 0];
  const measure = root => {
    for (const element of root.querySelectorAll("*")) {
      const box = element.getBoundingClientRect();
      if (["CANVAS", "INPUT", "SELECT", "PRE", "BUTTON"].includes(element.tagName))
        [right, lower] = [Math.max(right, box.right), Math.max(lower, box.bottom)];
      if (element.shadowRoot) measure(element.shadowRoot);
    }
  };
  measure(document);
  return [right, lower];
}"""
NOISE = """() => Bokeh.documents[0].get_model_by_name("errors").title.text.includes("noise")"""


def draw(page: Page, name: str) -> None:
    """Save the whole page, once the errors of the widths are drawn."""
    page.wait_for_function(NOISE)
    page.wait_for_timeout(2000)  # milliseconds, of the last drawing
    width, height = page.evaluate(EXTENT)
    clip = {"x": 0, "y": 0, "width": width + ROOM, "height": height + ROOM}
    page.screenshot(path=PICTURES / name, clip=clip, full_page=True)


def main() -> None:
    """Draw a slice with grains, and a profile with its call."""
    with (
        subprocess.Popen(COMMAND, stderr=subprocess.PIPE, text=True, cwd=DATA) as server,
        sync_playwright() as playwright,
    ):
        address = re.search(r"http://127\.0\.0\.1:\d+", server.stderr.readline())[0]
        chromium = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        page = chromium.new_page(viewport={"width": 1240, "height": 900})
        page.set_default_timeout(180_000)
        page.goto(address)
        page.get_by_label("picture", exact=True).select_option("slice")
        page.locator("input[type=checkbox]:visible").nth(0).check()
        page.wait_for_timeout(5000)
        draw(page, "explore.png")
        page.locator("input[type=checkbox]:visible").nth(0).uncheck()
        page.get_by_label("picture", exact=True).select_option("profile")
        page.wait_for_timeout(5000)
        draw(page, "explore_profile.png")
        chromium.close()
        server.terminate()


if __name__ == "__main__":
    main()
