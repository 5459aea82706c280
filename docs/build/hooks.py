"""Hooks that give the site its figures and equations and keep it off the network.

mkdocs calls these functions (`hooks` in mkdocs.yml). The pages stay readable as they lie in the repository:
they link figures as ``../figures/x.png`` and write equations as ``$...$``.
"""

from __future__ import annotations

import html
import json
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File

from cpam_bayes.documents import DOCUMENTS, json_schema

_PROJECT = Path(__file__).parents[2]

# ](../figures/x.png) in a page; the site has the same files under figures/
_FIGURE_LINK = re.compile(r"(?<=\]\()\.\./(?=figures/[\w.]+\.png\))")
# A figure with the title of its caption alone, between its marks
_TITLED = re.compile(
    r"(?P<link>!\[Figure\]\(\.\./figures/(?P<name>\w+)\.png\)\n\n)\*\*[^*]+\*\*\n\n(?=<!-- /figure -->)"
)
_EQUATION = re.compile(
    r'<(?P<tag>span|div) class="arithmatex">\\(?P<open>[(\[])(?P<latex>.*?)\\[)\]]</(?P=tag)>', re.DOTALL
)
# What a browser fetches by itself; an ordinary link is fetched only when it is followed
_FETCHED = re.compile(
    r'<(?:script|img|iframe|source)\b[^>]*?\ssrc="?(?://|https?:)[^">\s]*'
    r'|<link\b(?=[^>]*\brel="?(?:stylesheet|preconnect|preload|icon))[^>]*?\shref="?(?://|https?:)[^">\s]*'
    r"|url\([\"']?(?://|https?:)[^)]*"
)


def on_files(files: Any, *, config: Any) -> Any:
    """Add the figures that pages show, and the JSON schemas of the commands' documents."""
    for command in DOCUMENTS:
        text = json.dumps(json_schema(command), indent=1, ensure_ascii=False) + "\n"
        files.append(File.generated(config, f"schema/{command}.json", content=text))
    for figure in sorted((_PROJECT / "figures").glob("*.png")):
        files.append(File.generated(config, f"figures/{figure.name}", abs_src_path=str(figure)))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Redirect links to figures to those of the site, and captions to figures with only a title."""
    return _FIGURE_LINK.sub("", _TITLED.sub(_captioned, markdown))


def _captioned(titled: re.Match[str]) -> str:
    title, text, *_ = (_PROJECT / "figures" / f"{titled['name']}.md").read_text("utf-8").split("\n\n")
    return f"{titled['link']}{title}\n{text}\n\n"


def on_page_content(content: str, **_: Any) -> str:
    """Turn equations into MathML, which browsers show without a script."""
    return _EQUATION.sub(_mathml, content)


def on_post_page(output: str, *, page: Any, **_: Any) -> str:
    """Refuse a page that fetches from a network, or that still contains an equation in its source form."""
    if fetched := _FETCHED.search(output):
        raise PluginError(f"{page.file.src_uri}: fetched from a network: {fetched.group()}")
    if "arithmatex" in output:
        raise PluginError(f"{page.file.src_uri}: an equation was not converted")
    return output


def _mathml(equation: re.Match[str]) -> str:
    display = "inline" if equation["open"] == "(" else "block"
    return convert(html.unescape(equation["latex"]).strip(), display=display)
