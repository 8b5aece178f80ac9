"""Text that comes from outside, such as the names of files, made harmless to show."""

from __future__ import annotations

import unicodedata

# Control characters, direction and joining marks, halves of pairs (bytes of names that are no UTF-8), line separators
_HIDDEN = {"Cc", "Cf", "Cs", "Zl", "Zp"}


def visible(text: str) -> str:
    """Text whose hidden characters are escaped: hidden characters move the cursor, colour, or turn the direction of
    writing.

    Parameters
    ----------
    text : str

    Returns
    -------
    str
        A line of UTF-8; a byte of a file name that is not UTF-8 stands as ``\\xff``.
    """
    return "".join(
        _escaped(character) if unicodedata.category(character) in _HIDDEN else character for character in text
    )


def _escaped(character: str) -> str:
    code = ord(character)
    if 0xDC80 <= code <= 0xDCFF:  # how Python holds bytes that are no UTF-8
        code -= 0xDC00
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


_IN_ASCII = {
    "–": "-",
    "−": "-",
    "…": "...",
    "·": "*",
    "×": "x",
    "°": " deg",
    "²": "^2",
    "Λ": "Lambda",
    "ζ": "zeta",
    "χ": "chi",
    "ρ": "rho",
    "σ": "sigma",
    "β": "beta",
    "\u0304": "bar",  # over a letter
}


def in_ascii(error: UnicodeError) -> tuple[str, int]:
    """Handler of codec errors that spells the characters of this package; others are escaped."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = error.object[error.start : error.end]
    spelled = (_IN_ASCII.get(character) for character in text)
    known = [word or _escaped(character) for word, character in zip(spelled, text, strict=True)]
    return "".join(known), error.end
