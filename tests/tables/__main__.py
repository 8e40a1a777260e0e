"""``python -m tests.tables messages`` or ``python -m tests.tables px4_events FILE``: writes the table."""

from __future__ import annotations

import sys
from pathlib import Path

from tests.tables import messages, px4_events


def main(arguments: list[str]) -> int:
    """Write one table; exit status 2 for other arguments."""
    match arguments:
        case ["messages"]:
            messages.FILE.write_text(messages.table(), encoding="ascii")
        case ["px4_events", file]:
            px4_events.FILE.write_text(px4_events.table(Path(file)), encoding="ascii")
        case _:
            print(__doc__, file=sys.stderr)
            return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
