"""Makes external text (names, paths, messages of vehicles, records of logs) safe to print."""

from __future__ import annotations

import re

# C0 and C1 except tab and line feed, marks of the writing direction, line separators, and surrogates (bytes
# of a path that are not UTF-8)
_HIDDEN = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")


def plain(text: object) -> str:
    """Text with visible control characters: no colour, no cursor movement, no overwriting."""
    return _HIDDEN.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), str(text))


def one_line(text: object) -> str:
    """The same in one line, so that a text cannot imitate lines of another one."""
    return plain(text).replace("\n", "\\n").replace("\t", "\\t")
