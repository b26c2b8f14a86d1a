"""The README's page of code is the pipeline's own, the files it names are there, and it stays short."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE = "src/mocap_pipeline/mocap_pipeline/pipeline.py"
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "src").glob("*/README.md"))]
MOST_WORDS = 900
MOST_PAGES = 25
CODE, NAMING = ("src", "bench", "models", "scripts", "examples", "config"), (".py", ".sh", ".xml", ".yaml")
FILE = re.compile(r"\b([a-z_]+)/((?:[a-z_]+/)*)([a-z_]+\.py)?")


def page_of_code() -> list[str]:
    """Lines of the README's block of the pipeline."""
    block = re.search(r"```python\n(# segment.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.S)
    assert block is not None
    return block.group(1).splitlines()


def test_every_statement_of_the_readme_s_page_stands_in_the_pipeline_in_the_same_order():
    pipeline = (ROOT / PAGE).read_text(encoding="utf-8")
    statements = [line.split("  #")[0].strip() for line in page_of_code() if not line.startswith("#")]
    places = [pipeline.find(statement) for statement in statements]
    assert len(statements) >= 7
    assert -1 not in places and places == sorted(places)


def test_every_file_and_folder_that_the_page_names_exists():
    named = [match.group(0) for line in page_of_code() for match in FILE.finditer(line)]
    assert len(named) >= 15
    missing = [name for name in named if not (ROOT / "src" / name.split("/")[0] / name).exists()]
    assert not missing


def test_the_readme_is_short_as_wc_counts_words_with_code_and_tables():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").split()) <= MOST_WORDS


def test_every_page_stands_in_the_list_of_pages():
    listed = set(re.findall(r"\]\((\w+\.md)\)", (ROOT / "docs" / "index.md").read_text(encoding="utf-8")))
    assert listed == {page.name for page in (ROOT / "docs").glob("*.md")} - {"index.md"}
    assert len(listed) < MOST_PAGES


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_every_link_of_the_documentation_leads_to_a_file_and_its_heading():
    links = [
        (page, page.parent / target if target else page, anchor)
        for page in PAGES
        for target, anchor in re.findall(r"\]\(([^)#\s]*)#?([^)\s]*)\)", page.read_text(encoding="utf-8"))
        if not target.startswith(("http:", "https:"))
    ]
    assert sum(bool(anchor) for *_, anchor in links) > 30
    assert not [
        f"{page.relative_to(ROOT)}: {target.name}#{anchor}"
        for page, target, anchor in links
        if not target.exists() or (anchor and anchor not in anchors(target))
    ]


def test_every_image_stands_in_a_page():
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert not [image.name for image in (ROOT / "docs" / "images").iterdir() if f"images/{image.name})" not in text]


def test_every_page_that_code_names_exists():
    files = [path for folder in CODE for path in sorted((ROOT / folder).rglob("*.*")) if path.suffix in NAMING]
    named = {
        (path.relative_to(ROOT), page)
        for path in [ROOT / "Makefile", *files]
        for page in re.findall(r"\bdocs/(\w+\.md)\b", path.read_text(encoding="utf-8"))
    }
    assert len(named) > 20
    assert not [f"{path}: {page}" for path, page in sorted(named) if not (ROOT / "docs" / page).exists()]


def test_every_script_and_test_that_the_documentation_names_exists():
    named = re.compile(r"\b((?:bench|models|scripts|tests|src/[a-z_]+/test|examples)/[\w/]+\.(?:py|sh))\b")
    found = {(page, path) for page in PAGES for path in named.findall(page.read_text(encoding="utf-8"))}
    assert len(found) > 15
    assert not [f"{page.relative_to(ROOT)}: {path}" for page, path in sorted(found) if not (ROOT / path).exists()]
