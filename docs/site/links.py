"""Links of the documents to files of the repository that are no pages: they must be there, and stand on the site as names."""

import os
import re
from pathlib import Path

REPOSITORY = Path(os.environ["OMNIDRONES_REPOSITORY"])
PAGES = Path(os.environ["OMNIDRONES_DOCUMENTS"])
LINK = re.compile(r"(?<!!)\[([^\]]*)\]\(([^)#:\s]+)(#[^)\s]*)?\)")


def on_page_markdown(markdown, page, **_):
    """Called by mkdocs for every page."""

    def told(match):
        text, target = match[1], match[2]
        place = os.path.normpath(os.path.join(os.path.dirname(page.file.src_uri), target))
        if (PAGES / place).is_file():
            return match[0]
        if not (REPOSITORY / place).exists():
            raise SystemExit(f"{page.file.src_uri}: {target} is not in the repository")
        return text if place in text else f"{text} (`{place}`)"

    # code is left as it is
    parts = re.split(r"(^```.*?^```)", markdown, flags=re.S | re.M)
    return "".join(part if part.startswith("```") else LINK.sub(told, part) for part in parts)
