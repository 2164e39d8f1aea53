"""Small models, each with one thing that is not a plain geom; every one is held to MuJoCo's own pictures."""

from __future__ import annotations

_HEAD = """<mujoco>
  <visual><map znear="0.01" zfar="30"/><quality offsamples="0"/></visual>
  <statistic extent="2" center="0 0 0.4"/>
  <asset>
    <texture name="grid" type="2d" builtin="checker" rgb1=".1 .2 .3" rgb2=".8 .7 .6" width="99" height="99"/>
    <texture name="sides" type="cube" builtin="gradient" rgb1="1 0 0" rgb2="0 1 1" width="64" height="64"/>
    <texture name="marked" type="cube" builtin="flat" rgb1=".9 .8 .2" width="64" height="64" mark="cross"/>
    <material name="grid" texture="grid" texrepeat="3 2"/>
    <material name="uniform" texture="grid" texrepeat="3 2" texuniform="true"/>
    <material name="sides" texture="sides"/>
    <material name="marked" texture="marked" texuniform="true"/>
    {assets}
  </asset>
  <worldbody>
    <light pos="1 1 3" dir="-.3 -.3 -1" diffuse=".7 .7 .7"/>
    <geom name="floor" type="plane" size="1.5 1.5 .1" rgba=".3 .4 .3 1"/>
    <camera name="fixed" pos="0.1 -2.6 1.5" xyaxes="1 0 0 0 .5 1"/>
    {bodies}
  </worldbody>
  {rest}
</mujoco>"""


def _model(bodies: str, assets: str = "", rest: str = "") -> str:
    return _HEAD.format(assets=assets, bodies=bodies, rest=rest)


_HILLS = " ".join(f"{(7 * i * i + 3 * i) % 11 / 10:.1f}" for i in range(63))

_BENT_SKIN = """<deformable><skin name="cloth" {look}
  vertex="-.4 0 .2  0 0 .2  .4 0 .2  -.4 .4 .2  0 .4 .2  .4 .4 .2  -.4 0 .6  0 0 .6  .4 0 .6"
  {uv} face="0 1 6  1 7 6  1 2 7  2 8 7  3 4 0  4 1 0">
  <bone body="left" bindpos="-.4 0 .2" bindquat="1 0 0 0" vertid="0 3 6 1 4 7" vertweight="1 1 1 .5 .5 .5"/>
  <bone body="right" bindpos=".4 0 .2" bindquat="1 0 0 0" vertid="2 5 8 1 4 7" vertweight="1 1 1 .5 .5 .5"/>
</skin></deformable>"""
_BONES = """<body name="left" pos="-.4 0 .3"><joint axis="0 1 0"/><geom size=".05" contype="0"/></body>
  <body name="right" pos=".4 0 .5"><joint axis="1 0 0"/><geom size=".05" contype="0"/></body>"""
_UV = 'texcoord="0 0 .5 0 1 0 0 1 .5 1 1 1 0 1 .5 1 1 1"'

_TENDON = """<body pos="-.5 0 .9"><joint axis="0 1 0"/><geom type="box" size=".1 .1 .1"/>
  <site name="a" size=".02"/></body>
  <geom name="wheel" type="cylinder" size=".15 .1" pos="0 0 .9" euler="90 0 0" rgba=".8 .3 .2 1"/>
  <site name="beside" pos="0 0 1.15"/><body pos=".5 0 .5"><joint axis="0 1 0"/><geom size=".1"/>
  <site name="b" size=".02"/></body>"""
_SPATIAL = """<tendon><spatial width=".02" rgba=".9 .2 .3 {alpha}" {look}><site site="a"/>
  <geom geom="wheel" sidesite="beside"/><site site="b"/></spatial></tendon>"""

_SAIL = """<flexcomp name="sail" type="grid" count="5 5 1" spacing=".15 .15 .15" pos="0 0 .8" radius=".01"
  dim="2" {look}><edge equality="true"/></flexcomp>"""
_TETRAHEDRA = """<flexcomp name="jelly" type="grid" count="3 3 3" spacing=".15 .15 .15" pos="0 0 .6"
  radius=".005" dim="3" rgba=".2 .7 .4 1"/>"""
_ROPE = """<flexcomp name="rope" type="grid" count="8 1 1" spacing=".1 .1 .1" pos="0 0 .6" radius=".02"
  dim="1" rgba=".8 .7 .2 1"/>"""

_UV_MESH = """<mesh name="wedge" vertex="-.2 -.2 -.1  .2 -.2 -.1  .2 .2 -.1  -.2 .2 -.1  0 0 .3" {uv}
  face="0 2 1  0 3 2  0 1 4  1 2 4  2 3 4  3 0 4"/>"""

MODELS = {
    "tendon around a wheel": _model(_TENDON, rest=_SPATIAL.format(alpha=1, look="")),
    "clear tendon": _model(_TENDON, rest=_SPATIAL.format(alpha=0.5, look="")),
    "tendon with a texture": _model(_TENDON, rest=_SPATIAL.format(alpha=1, look='material="grid"')),
    "height field": _model(
        '<geom type="hfield" hfield="hills" rgba=".6 .5 .3 1"/>',
        f'<hfield name="hills" nrow="7" ncol="9" size=".8 .6 .5 .2" elevation="{_HILLS}"/>',
    ),
    "height field with a texture": _model(
        '<geom type="hfield" hfield="hills" material="grid"/>',
        f'<hfield name="hills" nrow="7" ncol="9" size=".8 .6 .5 .2" elevation="{_HILLS}"/>',
    ),
    "height field with a cube texture": _model(
        '<geom type="hfield" hfield="hills" material="sides"/>',
        f'<hfield name="hills" nrow="7" ncol="9" size=".8 .6 .5 .2" elevation="{_HILLS}"/>',
    ),
    "skin": _model(_BONES, rest=_BENT_SKIN.format(look='rgba=".9 .4 .3 1"', uv="")),
    "skin with a texture": _model(
        _BONES, rest=_BENT_SKIN.format(look='material="grid"', uv=_UV)
    ),
    "cloth": _model(_SAIL.format(look='rgba=".3 .4 .9 1"')),
    "cloth with a texture": _model(_SAIL.format(look='material="grid"')),
    "jelly": _model(_TETRAHEDRA),
    "rope": _model(_ROPE),
    "slider-crank": _model(
        """<body pos="0 0 .5"><joint type="hinge" axis="0 1 0"/><geom size=".1"/>
        <site name="crank" pos=".2 0 0"/></body>
        <body pos=".7 0 .5"><joint type="slide" axis="1 0 0"/><geom type="box" size=".1 .1 .1"/>
        <site name="slider" euler="0 -90 0"/></body>""",
        rest="""<actuator><general cranksite="crank" slidersite="slider" cranklength=".6"/></actuator>""",
    ),
    "range finder": _model(
        """<site name="eye" pos="-.6 0 .5" euler="0 90 0"/>
        <body pos=".5 0 .5"><geom type="box" size=".1 .2 .3"/></body>""",
        rest='<sensor><rangefinder site="eye"/></sensor>',
    ),
    "cube texture on a mesh with coordinates": _model(
        '<geom type="mesh" mesh="wedge" material="sides" pos="0 0 .5"/>',
        _UV_MESH.format(uv='texcoord="0 0 1 0 1 1 0 1 .5 .5"'),
    ),
    "cube textures on plain solids": _model(
        """<geom type="mesh" mesh="wedge" material="marked" pos="0 0 .5"/>
        <geom type="box" size=".2 .1 .15" material="marked" pos=".6 0 .5"/>
        <geom type="sphere" size=".2" material="sides" pos="-.6 0 .5"/>""",
        _UV_MESH.format(uv=""),
    ),
}  # fmt: skip
"""MJCF by what it shows."""

CROWD = _model(
    """<body name="hanging" pos="-.5 0 .9"><joint name="hinge" axis="0 1 0"/>
    <geom type="box" size=".1 .1 .1"/></body>
    <body pos="-.2 -.3 .12"><freejoint/><geom type="box" size=".15 .1 .12"/>
    <geom type="mesh" mesh="hollow" pos="0 0 .2" rgba=".3 .6 .9 1"/></body>
    <body name="ball" pos=".4 -.3 .14"><freejoint/><geom type="ellipsoid" size=".15 .1 .15"/></body>
    <camera pos="0 -.5 1" euler="60 0 0"/>""",
    """<mesh name="hollow" vertex="-.1 -.1 -.1 .1 -.1 -.1 .1 .1 -.1 -.1 .1 -.1 0 0 .1 0 0 0"
    face="0 2 1 0 3 2 0 1 4 1 2 4 2 3 4 3 0 4"/>""",
    """<actuator><motor joint="hinge"/></actuator>
    <equality><connect body1="hanging" body2="ball" anchor="0 0 .2" solref=".5 1"/></equality>""",
)
"""Bodies that touch, hang, turn and are driven: something for every decoration."""
