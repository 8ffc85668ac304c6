"""Equations as MathML, made when the site is built: browsers draw them without any script."""

import html
import re

from latex2mathml.converter import convert

_FORMULA = re.compile(
    r'<(span|div) class="arithmatex">\s*\\[(\[](.*?)\\[)\]]\s*</\1>', flags=re.DOTALL
)
_TAG = re.compile(r"\\tag\{([^}]*)\}")
_LETTER = re.compile(r'<mi mathvariant="(bold|bold-italic|double-struck)">([^<]*)</mi>')
_UPRIGHT = re.compile(r'<mrow>((?:<mi mathvariant="normal">\w</mi>)+)</mrow>')
# MathML Core has no bold: styled letters are separate characters.
_BOLD, _REALS = (0x1D400, 0x1D41A), "ℝ"


def with_mathml(page: str) -> str:
    """Return a page's HTML with each formula of `pymdownx.arithmatex` as MathML."""
    return _FORMULA.sub(_formula, page)


def mathml(latex: str, display: str = "inline") -> str:
    """Return a formula as MathML that browsers draw as it is meant."""
    made = convert(latex, display=display)
    made = _UPRIGHT.sub(lambda m: f"<mi>{re.sub('<[^>]*>', '', m[1])}</mi>", made)
    return _LETTER.sub(lambda m: f"<mi>{_styled(html.unescape(m[2]), m[1])}</mi>", made)


def _formula(match: re.Match[str]) -> str:
    latex, block = html.unescape(match[2]).strip(), match[1] == "div"
    number = _TAG.search(latex)
    made = mathml(_TAG.sub("", latex), "block" if block else "inline")
    if not block:
        return made
    label = f'<span class="eq-number">({html.escape(number[1])})</span>' if number else ""
    return f'<div class="equation">{made}{label}</div>'


def _styled(letter: str, look: str) -> str:
    if look == "double-struck" and letter == "R":
        return _REALS
    if look == "bold" and letter.isascii() and letter.isalpha():
        base = _BOLD[0] if letter.isupper() else _BOLD[1]
        return chr(base + ord(letter.lower()) - ord("a"))
    return letter
