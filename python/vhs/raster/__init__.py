"""A renderer for MuJoCo models that needs no OpenGL: `RasterRenderer` has the methods of `mujoco.Renderer`.

MuJoCo itself says what is to be drawn: `mjv_updateScene` lists geoms, tendons, skins, decorations and lights
in an abstract scene, and this package draws that scene as MuJoCo's OpenGL renderer does. The drawing is Rust
(`rust/vhs-raster`). MuJoCo is imported by the first renderer, so `import vhs` stays light.
"""

from vhs.raster.install import Installed, install
from vhs.raster.renderer import Antialias, RasterRenderer

__all__ = ["Antialias", "Installed", "RasterRenderer", "install"]
