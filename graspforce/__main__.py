"""``python -m graspforce`` is the command ``graspforce``."""

import sys

from graspforce.cli import main

sys.exit(main())
