"""What the stand-in lacks is the real package's, where `STAND_IN_REST` says where that is.

`STAND_IN_VERSION` is what it says of itself.
"""

import os

__path__ = [*__path__, *filter(None, [os.environ.get("STAND_IN_REST")])]
__version__ = os.environ.get("STAND_IN_VERSION")
