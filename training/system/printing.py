"""Text for terminals and pipes that are not UTF-8: what they cannot show becomes what resembles it,
and nothing that is printed raises UnicodeEncodeError.

The error handler "legible" of Python's codecs does so: `text.encode("latin-1", "legible")`.
"""

from __future__ import annotations

import codecs
import sys
import unicodedata
from typing import Any

LEGIBLE = "legible"
# those that raise, and stderr's own, which writes "\\u2212" for a minus sign
REPLACED_HANDLERS = ("strict", "surrogateescape", "backslashreplace")
RESEMBLING = {
    **{dash: "-" for dash in "\u2010\u2011\u2012–—−─━"},
    **dict.fromkeys("‘’", "'"),
    **dict.fromkeys("“”", '"'),
    **{"×": "x", "✗": "x", "✓": "v", "·": ".", "●": "*", "†": "+", "│": "|", "⁄": "/"},
    **{"→": "->", "±": "+-", "≤": "<=", "≥": ">=", "≠": "!=", "°": " deg"},
    **{"«": '"', "»": '"', "ß": "ss", "æ": "ae", "œ": "oe", "ø": "o", "ł": "l"},
    **{"δ": "delta", "ε": "eps", "μ": "u", "σ": "sigma"},
}


def use_legible(stream: Any) -> None:
    """Have a stream print what its encoding lacks legibly, if it can be told to; the handlers
    "replace" and "ignore", chosen with PYTHONIOENCODING, stay.

    Args:
        stream: `sys.stdout` or `sys.stderr`, or anything that stands in for them.
    """
    reconfigure = getattr(stream, "reconfigure", None)
    if reconfigure is not None and getattr(stream, "errors", None) in REPLACED_HANDLERS:
        reconfigure(errors=LEGIBLE)


def printable(text: str) -> str:
    """Return a text with what standard output cannot show in characters that it can."""
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    return text.encode(encoding, LEGIBLE).decode(encoding)


def _legible(error: UnicodeError) -> tuple[str, int]:
    """Replace what an encoding lacks: codecs' handler of errors.

    Returns:
        ASCII characters, and where to go on.
    """
    if not isinstance(error, UnicodeEncodeError):
        raise error
    lacking = error.object[error.start : error.end]
    return "".join(map(_resembling, lacking)), error.end


def _resembling(character: str) -> str:
    """Return ASCII characters in place of one that is not ASCII, or "?"."""
    plain = ""
    # "é" is "e" and an accent
    for part in unicodedata.normalize("NFKD", character):
        plain += part if part.isascii() else RESEMBLING.get(part, "")
    return plain or "?"


codecs.register_error(LEGIBLE, _legible)
