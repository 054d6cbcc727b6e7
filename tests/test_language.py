"""The language of the package: how often its text says "what" and "where", and whether docstrings are imperative.

    python tests/test_language.py

prints the counts of every package. The text is that of docstrings, comments, and strings of at least three words in
robustopt/, and the prose of README.md and docs/, without code. As in ruff's rule D401, only functions and methods must
begin with an imperative: the docstring of a module or a class describes it, and the one of a property names a value.
"""

import ast
import io
import re
import tokenize
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent

MOST = {"what": 10, "where": 40}
"""Largest number per 10,000 words."""

IMPERATIVE = 0.85
"""Smallest share of docstrings that begin with an imperative."""

WORDS = (ROOT / "tests/fixtures/verbs.txt").read_text(encoding="utf-8").split()

VERBS = frozenset(word.rstrip("*") for word in WORDS)
"""Base forms of the verbs that docstrings may begin with."""

NOUNS_TOO = frozenset(word.rstrip("*") for word in WORDS if word.endswith("*"))
"""Verbs that are also nouns, marked by a star in the file; they count as nouns if a word like "of" follows."""

AFTER_A_NOUN = (
    "of",
    "that",
    "which",
    "whose",
    "in",
    "on",
    "at",
    "for",
    "from",
    "by",
    "with",
    "without",
    "where",
    "when",
    "is",
    "are",
)


def is_imperative(docstring: str) -> bool:
    """Return whether a docstring begins with a verb in its base form."""
    first, following = [*docstring.lower().split(maxsplit=2), "", ""][:2]
    if first.rstrip(",") not in VERBS:
        return False
    return first.rstrip(",") not in NOUNS_TOO or not (first.endswith(",") or following in AFTER_A_NOUN)


def is_property(function: ast.AST) -> bool:
    """Return whether a function is decorated to be used as a value, such as by `property` or `cached_property`."""
    return any("property" in ast.unparse(decorator) for decorator in getattr(function, "decorator_list", ()))


def docstrings(tree: ast.AST) -> Iterator[str]:
    """Yield the docstrings of all functions and methods but properties."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not is_property(node):
            text = ast.get_docstring(node)
            if text:
                yield text


def texts(source: str) -> Iterator[str]:
    """Yield the comments of a module, its docstrings, and its strings of at least three words."""
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield token.string
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and len(words_of(node.value)) >= 3:
            yield node.value


def prose(page: str) -> str:
    """Return the text of a Markdown page without its code."""
    return re.sub(r"^```.*?^```|`[^`\n]*`", " ", page, flags=re.DOTALL | re.MULTILINE)


def words_of(text: str) -> list[str]:
    """Return the words of a text in lower case."""
    return re.findall(r"[a-z]+(?:'[a-z]+)?", text.lower())


def package_of(path: Path) -> str:
    """Return the package that a module belongs to, or the name of a page."""
    parts = path.relative_to(ROOT).parts
    return "/".join(parts[:2]) if len(parts) > 1 else parts[0]


def counts() -> dict[str, Counter[str]]:
    """Return the numbers of words, of "what" and "where", of docstrings and of imperative ones, by package or page."""
    found: defaultdict[str, Counter[str]] = defaultdict(Counter)
    for path in sorted((ROOT / "robustopt").rglob("*.py")):
        source = path.read_text(encoding="utf-8")
        count = found[package_of(path)]
        for text in texts(source):
            count.update(_counted(text))
        for text in docstrings(ast.parse(source)):
            count.update(docstrings=1, imperative=is_imperative(text))
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        found[package_of(path)].update(_counted(prose(path.read_text(encoding="utf-8"))))
    return dict(found)


def _counted(text: str) -> dict[str, int]:
    words = words_of(text)
    return {"words": len(words), **{word: words.count(word) for word in MOST}}


def per_10000(count: Counter[str], word: str) -> float:
    """Return how often a word stands in 10,000 words."""
    return 1e4 * count[word] / max(count["words"], 1)


def table() -> str:
    """Return the counts as text, a line for every package or page, and one for all."""
    found = counts()
    lines = [f"{'':32}{'words':>8}{'what':>8}{'where':>8}{'docstrings':>12}{'imperative':>12}"]
    for name, count in [*found.items(), ("all", sum(found.values(), Counter()))]:
        share = f"{count['imperative'] / count['docstrings']:.0%}" if count["docstrings"] else ""
        often = "".join(f"{per_10000(count, word):8.1f}" for word in MOST)
        lines.append(f"{name:32}{count['words']:8}{often}{count['docstrings']:12}{share:>12}")
    return "\n".join(lines)


def test_words_are_rare() -> None:
    total = sum(counts().values(), Counter())
    assert all(per_10000(total, word) <= most for word, most in MOST.items()), table()


def test_docstrings_begin_with_an_imperative() -> None:
    total = sum(counts().values(), Counter())
    assert total["imperative"] >= IMPERATIVE * total["docstrings"], table()


def test_a_docstring_is_judged_by_its_first_words() -> None:
    good = (
        "Return the mean.",
        "Return, for each axis, the mean.",
        "Plan the path of a robot.",
        "Set the limits.",
        "Check that it ends.",
        "Wait for it.",
    )
    assert all(map(is_imperative, good))
    bad = (
        "The mean.",
        "Returns the mean.",
        "Plan of a robot.",
        "Plans of a robot.",
        "Whether it ends.",
        "Set, sorted.",
    )
    assert not any(map(is_imperative, bad))


if __name__ == "__main__":
    print(table())
