"""Checks that the files which documents link to exist.

usage: links.py DOCUMENT...
"""

import re
import sys
from pathlib import Path


def main():
    wrong, count = [], 0
    for document in map(Path, sys.argv[1:]):
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", document.read_text()):
            count += 1
            if not (document.parent / target).exists():
                wrong.append(f"{document}: {target} does not exist")
    print("\n".join(wrong) or f"  {count} links lead somewhere")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
