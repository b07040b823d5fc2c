"""The page on notation names what the code has."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "book" / "notation.md").read_text(encoding="utf-8")
CODE = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "src").rglob("*.py"))
#: Letters that one module uses for itself.
LOCAL = set("GIJLOQVW")


def test_every_name_beside_a_symbol_is_in_the_code():
    symbols = PAGE.split("## Symbols")[1].split("## Words")[0]
    names = {
        re.split(r"\W", code)[0] for code in re.findall(r"^\| \$.*?\| .*?`(?:masks = net\.)?(.*?)`", symbols, re.M)
    }
    assert len(names) > 10
    assert [name for name in sorted(names) if not re.search(rf"\b{name}\b", CODE)] == []


def test_axes_have_the_letters_of_the_page():
    shapes = re.findall(r'(?:Float|Int|Bool)\[(?:Tensor|np\.ndarray|NDArray), "(.*?)"\]', CODE)
    used = {axis.lstrip("*") for shape in shapes for axis in shape.split()}
    letters = set(re.findall(r"^\| ([A-Z]) \|", PAGE, re.M))
    strange = {axis for axis in used if re.fullmatch("[A-Z]", axis)} - LOCAL - letters
    assert not strange, f"say on the page on notation, or in LOCAL, what these axes are: {strange}"
    assert letters <= used
