"""The pages of docs: generated pages are up to date, and links, tables and examples of the others are correct."""

from __future__ import annotations

import ast
import importlib.util
import re
import shlex
from pathlib import Path
from types import ModuleType
from typing import get_args

import pytest
import yaml

from gyrowheel_analysis.model import Model
from gyrowheel_sim.effects import Effect, registry
from gyrowheel_sim.effects.declaration import Category
from gyrowheel_sim.effects.dimensions import check_effect
from gyrowheel_sim.effects.user_defined_line import typed_effect

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"


@pytest.fixture(scope="module")
def generator() -> ModuleType:
    """Return the generator script as a module."""
    spec = importlib.util.spec_from_file_location("gyrowheel_docs", ROOT / "tools" / "docs.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_generated_pages_are_up_to_date(generator: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of pictures the numbers are compared, which need not be drawn for that."""
    draw = generator.to_svg
    with monkeypatch.context() as patch:
        patch.setattr(generator, "to_svg", lambda _, numbers: f"<dc:description>{numbers}</dc:description>")
        pages = generator.made()
    assert [str(path.relative_to(ROOT)) for path in generator.stale(pages)] == [], "run `make docs`"
    # reproducible
    effect = registry()["aero_cross"]
    found = generator.signature(effect, generator.Bench.load())
    path = DOCS / "effects" / "aero_cross.svg"
    drawn = draw(found, generator.json.dumps(found.to_json()))
    assert generator._same(path, drawn)
    assert drawn == draw(found, generator.json.dumps(found.to_json()))


def test_labels_of_the_pictures_of_effects_are_where_they_were_drawn() -> None:
    """Matplotlib writes the place of a label twice, and that of a tick as the mark and as the end of its line."""
    places = r'x="(\S+)" y="(\S+)" transform="rotate\(\S+ (\S+) (\S+)\)"'
    ticks = r'<g id="ytick_\d+">.*?<path d="M (\S+) (\S+).*?<use xlink:href="\S+" x="(\S+)" y="(\S+)"'
    for picture in (DOCS / "effects").glob("*.svg"):
        text = picture.read_text(encoding="utf-8")
        found = [*re.findall(places, text), *re.findall(ticks, text, re.DOTALL)]
        assert len(found) > 8
        assert [(x, y) for x, y, *_ in found] == [(x, y) for *_, x, y in found], picture.name


@pytest.mark.slow
def test_outdated_pages_are_detected(
    generator: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    svg = (DOCS / "effects" / "aero_cross.svg").read_text(encoding="utf-8")
    folder = tmp_path / "effects"
    folder.mkdir()
    monkeypatch.setattr(generator, "DOCS", tmp_path)
    pages = {folder / "a.md": "text\n", folder / "b.svg": svg, folder / "c.md": "new\n"}
    (folder / "a.md").write_text("text\n", encoding="utf-8")
    (folder / "b.svg").write_text(svg.replace("stroke", "strokes"), encoding="utf-8")  # the same numbers
    (folder / "d.md").write_text("of a removed effect\n", encoding="utf-8")
    assert generator.stale(pages) == [folder / "c.md", folder / "d.md"]
    (folder / "a.md").write_text("old\n", encoding="utf-8")
    picture = generator.caps_figure(generator.Bench.load())
    (folder / "e.png").write_bytes(generator.png_bytes(picture, '{"a": [1.0, 2.0]}'))
    (folder / "e.csv").write_text("a,b\n1,2\n", encoding="utf-8")
    assert generator._same(folder / "e.png", generator.png_bytes(picture, '{"a": [1.0, 2.0001]}'))
    assert not generator._same(folder / "e.png", generator.png_bytes(picture, '{"a": [1.0, 2.1]}'))
    assert generator._same(folder / "e.csv", "a,b\n1,2.0001\n")
    assert not generator._same(folder / "e.csv", "a,b\n1,2.1\n")
    (folder / "e.png").unlink()
    (folder / "e.csv").unlink()
    (folder / "b.svg").write_text(re.sub(r"0\.08727", "0.08827", svg), encoding="utf-8")
    assert generator.stale(pages) == [folder / "a.md", folder / "b.svg", folder / "c.md", folder / "d.md"]


@pytest.mark.parametrize("effect", registry().values(), ids=lambda effect: effect.name)
def test_an_effect_page_has_the_whole_declaration(effect: Effect, generator: ModuleType) -> None:
    page = (DOCS / "effects" / f"{effect.name}.md").read_text(encoding="utf-8")
    for text in (effect.title[1:], effect.sentence, effect.validity[1:], effect.source, "gyrowheel simulate"):
        assert text in page
    for law in effect.laws:
        assert law.target in page
        formula = generator.latex(law.expression)
        assert f"$${formula}$$" in page
        assert formula.count("{") == formula.count("}")
    for c in effect.coefficients:
        assert f"| `{c.name}` |" in page
        assert c.source.replace("|", "\\|") in page
    for name, test in effect.look_alikes.items():
        assert name in page
        assert test in page
    index = (DOCS / "effects" / "README.md").read_text(encoding="utf-8")
    assert f"[{effect.name}]({effect.name}.md)" in index


def test_every_category_function_and_name_has_a_description(generator: ModuleType) -> None:
    assert set(generator._CATEGORIES) == set(get_args(Category))
    assert set(generator._FUNCTIONS) == set(generator.FUNCTIONS)
    assert set(generator._HANDY) == set(generator.HANDY)


def test_every_generated_table_is_on_one_page(generator: ModuleType) -> None:
    pages = "".join(path.read_text(encoding="utf-8") for path in DOCS.rglob("*.md"))
    for name in generator.tables():
        assert pages.count(f"<!-- table: {name} -->") == 1
    assert pages.count("<!-- table:") == pages.count("<!-- end -->") == len(generator.tables())


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page as on a forge: its headings, with a number appended to repeated ones."""
    found: set[str] = set()
    for heading in re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE):
        text = re.sub(r"\]\([^)]*\)", "", heading).lower()
        first = own = re.sub(r"[^\w\- ]", "", text).replace(" ", "-")
        number = 0
        while own in found:
            number += 1
            own = f"{first}-{number}"
        found.add(own)
    return found


def test_all_links_have_a_target() -> None:
    known = {page: anchors(page) for page in [*ROOT.glob("*.md"), *DOCS.rglob("*.md")]}
    wrong = []
    for page in known:
        text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
        for link in re.findall(r"\]\(([^)\s]+)\)", re.sub(r"`[^`\n]*`", "", text)):
            if "://" in link:
                continue
            path, _, place = link.partition("#")
            target = (page.parent / path).resolve() if path else page
            if not target.is_file() or (place and place not in known.get(target, ())):
                wrong.append(f"{page.relative_to(ROOT)}: {link}")
    assert wrong == []


def test_every_page_is_in_the_index(generator: ModuleType) -> None:
    index = generator.with_tables((DOCS / "README.md").read_text(encoding="utf-8"))
    for page in DOCS.glob("*.md"):
        assert page.name == "README.md" or f"]({page.name})" in index, page


def test_every_fault_names_a_test() -> None:
    """A row of docs/faults.md ends with an existing test, and states the kept data or the message."""
    rows = [
        line
        for line in (DOCS / "faults.md").read_text(encoding="utf-8").splitlines()
        if line.startswith("| ") and not line.startswith("| fault |")
    ]
    assert len(rows) > 30
    for row in rows:
        *told, last = (cell.strip() for cell in row.strip("|").split("|"))
        assert len(told) == 3, row
        assert any(told[1:]), row
        named = re.findall(r"`(tests/\w+(?:/\w+)*\.py)::(test_\w+)`", last)
        assert named, row
        for file, name in named:
            tests = ast.parse((ROOT / file).read_text(encoding="utf-8")).body
            assert name in {node.name for node in tests if isinstance(node, ast.FunctionDef)}, row


# --- docs/formulas.md

FORMULAS = (DOCS / "formulas.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", FORMULAS, re.DOTALL | re.MULTILINE)


def test_commands_on_the_formula_page_define_effects() -> None:
    commands = [
        shlex.split(line) for block in blocks("") for line in block.splitlines() if "--formula" in line
    ]
    assert len(commands) >= 2
    for words in commands:
        assert words[:3] == ["gyrowheel", "model", "add"]
        options = dict(zip(words[3::2], words[4::2], strict=True))
        effect = typed_effect(options["--formula"], name=options.get("--name"))
        assert effect.name == "stator_pull"
        assert {c.name: c.unit for c in effect.coefficients} == {"k": "N*m/rad"}


def test_the_model_file_on_the_formula_page_is_valid(tmp_path: Path) -> None:
    (text,) = blocks("yaml")
    model = Model.from_mapping(yaml.safe_load(text), "page")
    assert model.effects == {"stator_pull": {"k": 0.02}}
    assert model.declared["stator_pull"].category == "motor"


def test_the_package_on_the_formula_page_declares_valid_effects() -> None:
    (text,) = blocks("python")
    names = {node.id for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Name)}
    assert "EFFECTS" in names
    found: dict[str, list[Effect]] = {}
    exec(text, {}, found)  # the page's own code
    assert [effect.name for effect in found["EFFECTS"]] == ["lead_pull", "stator_pull"]
    for effect in found["EFFECTS"]:
        check_effect(effect)


# --- words

#: Replaced phrases that must not return; in parts here, so that this file does not contain them.
REPLACED = ["recko" + "ned", "size of " + "the tilt", "pressure of " + "the air", "clock on " + "the wall"]


def test_replaced_phrases_are_not_used() -> None:
    folders = ("src", "docs", "benchmarks", "tools", "examples", "tests")
    files = [ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
    for folder in folders:
        for kind in ("py", "md", "yaml", "xml", "msg", "rst"):
            files += (ROOT / folder).rglob(f"*.{kind}")
    assert len(files) > 300
    found = [
        f"{path.relative_to(ROOT)}: {word}"
        for path in files
        for word in REPLACED
        if word in " ".join(path.read_text(encoding="utf-8").lower().split())
    ]
    assert found == []


def test_modules_named_on_pages_exist() -> None:
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *DOCS.glob("*.md")]
    named = {
        name
        for page in pages
        for name in re.findall(r"`(gyrowheel_\w+/[\w/]+\.py)`", page.read_text("utf-8"))
    }
    assert named
    for name in named:
        package, _, rest = name.partition("/")
        assert (ROOT / "src" / package / package / rest).exists(), name
