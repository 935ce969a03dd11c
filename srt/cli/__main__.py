"""``python -m srt.cli``, where the script ``srt`` is not on the path."""

import sys

from srt.cli import main

sys.exit(main())
