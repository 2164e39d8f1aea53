//! MuJoCo's abstract scene (`mjvScene`) as records of bytes: geoms and lights, read field by field.
//!
//! Python found out where each field lies; here the bytes become what the renderer draws. Numbers of enumerations are
//! part of MuJoCo's file format (mjmodel.h, mjvisualize.h), so they do not change.

use vhs_raster::{Error, Geom, Heads, Light, LightKind, Result, Shape, Soft, Surface, TextureUse};

use crate::raster_feed::Poses;

const CATEGORY_DECOR: i32 = 4;
const OBJECT_GEOM: i32 = 5;
const GEOM_FLEX: i32 = 105;
const GEOM_SKIN: i32 = 106;
const LIGHT_SPOT: i32 = 0;
const LIGHT_DIRECTIONAL: i32 = 1;
/// A line box is drawn with lines this much wider than others.
const BOX_LINES: f32 = 1.5;

/// Where the fields of a record lie: first byte of each, in an order of their own.
pub(crate) type Places<const N: usize> = [Option<usize>; N];

/// Fields of a geom, in the order in which Python gives their places.
#[derive(Clone, Copy)]
#[repr(usize)]
enum G {
    Type,
    DataId,
    ObjType,
    ObjId,
    Category,
    MatId,
    SegId,
    Size,
    Pos,
    Mat,
    Rgba,
    Emission,
    Specular,
    Shininess,
    Reflectance,
    Label,
    // Newer than MuJoCo 3.3; absent before.
    TexId,
    TexUniform,
    TexRepeat,
    CastShadow,
}

/// Number of fields of a geom that are read.
pub(crate) const GEOM_FIELDS: usize = G::CastShadow as usize + 1;

/// Fields of a light, likewise.
#[derive(Clone, Copy)]
#[repr(usize)]
enum L {
    Pos,
    Dir,
    Type,
    Attenuation,
    Cutoff,
    Exponent,
    Ambient,
    Diffuse,
    Specular,
    Headlight,
    CastShadow,
    // Instead of the type before MuJoCo 3.3.3.
    Directional,
}

/// Number of fields of a light that are read.
pub(crate) const LIGHT_FIELDS: usize = L::Directional as usize + 1;

/// One record.
struct Record<'a, const N: usize> {
    bytes: &'a [u8],
    places: &'a Places<N>,
}

impl<const N: usize> Record<'_, N> {
    /// Four bytes of a field, `index` times four behind its start; zero where this MuJoCo lacks the field.
    fn four(&self, field: usize, index: usize) -> [u8; 4] {
        let place = self.places[field].map(|place| place + 4 * index);
        let four = place.and_then(|at| self.bytes.get(at..at + 4)?.first_chunk::<4>());
        four.copied().unwrap_or_default()
    }

    fn int(&self, field: usize) -> i32 {
        i32::from_ne_bytes(self.four(field, 0))
    }

    fn float(&self, field: usize) -> f32 {
        f32::from_ne_bytes(self.four(field, 0))
    }

    fn floats<const M: usize>(&self, field: usize) -> [f32; M] {
        std::array::from_fn(|i| f32::from_ne_bytes(self.four(field, i)))
    }

    /// Whether a byte is set; `otherwise` where this MuJoCo lacks the field.
    fn flag(&self, field: usize, otherwise: bool) -> bool {
        match self.places[field].and_then(|at| self.bytes.get(at)) {
            Some(&byte) => byte != 0,
            None => otherwise,
        }
    }
}

/// What geoms point at in the model, and where they are to the last bit.
pub(crate) struct Context<'a> {
    pub(crate) poses: &'a Poses,
    /// `geom_size` [n, 3].
    pub(crate) geom_size: &'a [f64],
    /// Texture of each material; -1 for none.
    pub(crate) material_texture: &'a [i32],
    pub(crate) material_uniform: &'a [u8],
    /// Repetitions of each material [n, 2].
    pub(crate) material_repeat: &'a [f32],
    /// Number of each of the model's textures in the scene; `None` for one that no renderer shows.
    pub(crate) textures: &'a [Option<usize>],
    /// For each of the model's meshes its number in the scene, and that of its hull.
    pub(crate) meshes: &'a [[usize; 2]],
    /// Width of lines in pixels.
    pub(crate) line_width: f32,
    pub(crate) softs: &'a Softs,
    /// Whether tags are the numbers that MuJoCo gives for segmentation, instead of objects.
    pub(crate) is_numbered: bool,
}

/// Surfaces that bend at this moment.
#[derive(Default)]
pub(crate) struct Softs {
    pub(crate) surfaces: Vec<Soft>,
    /// For each skin its surface.
    pub(crate) skins: Vec<usize>,
    pub(crate) flexes: Vec<Flex>,
}

/// A flexible body at this moment.
#[derive(Default)]
pub(crate) struct Flex {
    /// Its surface, if it shows one.
    pub(crate) surface: Option<usize>,
    /// Vertices that are shown as balls.
    pub(crate) balls: Vec<[f32; 3]>,
    /// Edges that are shown as tubes.
    pub(crate) edges: Vec<[[f32; 3]; 2]>,
}

/// Appends the geoms of `records`, `stride` bytes each.
///
/// # Errors
/// [`Error::Unsupported`] for a label, [`Error::Index`] for a record that points past a table's end.
pub(crate) fn read_geoms(
    records: &[u8],
    stride: usize,
    places: &Places<GEOM_FIELDS>,
    context: &Context<'_>,
    geoms: &mut Vec<Geom>,
) -> Result<()> {
    for bytes in records.chunks_exact(stride) {
        let record = Record { bytes, places };
        if record.flag(G::Label as usize, false) {
            return Err(Error::Unsupported {
                what: "text labels".into(),
            });
        }
        let geom = geom_of(&record, context)?;
        match record.int(G::Type as usize) {
            GEOM_FLEX => push_flex(geom, record.int(G::ObjId as usize), context, geoms)?,
            // A type of this number is a placeholder that nothing draws.
            107 | 1001 => {}
            _ => geoms.push(geom),
        }
    }
    Ok(())
}

/// The geom of a record; a flex gets its shape later.
fn geom_of(record: &Record<'_, GEOM_FIELDS>, context: &Context<'_>) -> Result<Geom> {
    let object = [G::ObjId, G::ObjType].map(|field| record.int(field as usize));
    let rounded_at: [f32; 3] = record.floats(G::Pos as usize);
    let rounded_rotation: [f32; 9] = record.floats(G::Mat as usize);
    let shape = shape_of(record, context)?;
    let exact = context.poses.of(object);
    // Geoms and sites of the model are placed by their f64 poses, unless they were moved in the scene.
    let is_endless = matches!(shape, Shape::Plane { half_size, .. } if half_size[0] <= 0.0 || half_size[1] <= 0.0);
    let position = match exact {
        Some((at, _)) if is_endless || is_rounded(&at, &rounded_at) => at,
        _ => rounded_at.map(f64::from),
    };
    let rotation = match exact {
        Some((_, rotation)) if is_rounded(&rotation, &rounded_rotation) => rotation,
        _ => rounded_rotation.map(f64::from),
    };
    let number = record.int(G::SegId as usize);
    let is_line = matches!(shape, Shape::Line { .. });
    let is_decor = record.int(G::Category as usize) == CATEGORY_DECOR;
    Ok(Geom {
        shape,
        surface: surface_of(record, context)?,
        position,
        rotation,
        tag: (number >= 0).then_some(if context.is_numbered {
            [number, 0]
        } else {
            object
        }),
        casts_shadow: !is_decor && !is_line && record.flag(G::CastShadow as usize, true),
    })
}

/// Whether f32 numbers are these f64 numbers, rounded.
#[expect(clippy::cast_possible_truncation, reason = "rounding is meant")]
#[expect(clippy::float_cmp, reason = "the same number or another one")]
fn is_rounded<const N: usize>(exact: &[f64; N], rounded: &[f32; N]) -> bool {
    exact.iter().zip(rounded).all(|(&e, &r)| e as f32 == r)
}

fn shape_of(record: &Record<'_, GEOM_FIELDS>, context: &Context<'_>) -> Result<Shape> {
    let size: [f32; 3] = record.floats(G::Size as usize);
    let [x, y, z] = size;
    let data = usize::try_from(record.int(G::DataId as usize)).ok();
    let object = usize::try_from(record.int(G::ObjId as usize)).unwrap_or(usize::MAX);
    Ok(match (record.int(G::Type as usize), data) {
        (0, _) => plane_of(record, context),
        (1, Some(field)) => Shape::HeightField {
            field,
            half_size: size,
        },
        (2, _) => Shape::Sphere { radius: x },
        (3, _) => Shape::Capsule {
            radius: x,
            half_length: z,
        },
        (4, _) => Shape::Ellipsoid { radii: size },
        (5, _) => Shape::Cylinder {
            radius: x,
            half_length: z,
        },
        (6, _) => Shape::Box { half_size: size },
        (7 | 8, Some(data)) => {
            let pair = entry("mesh of a geom", context.meshes, data / 2)?;
            Shape::Mesh {
                mesh: pair[data % 2],
                half_size: size,
            }
        }
        (100, _) => arrow(size, Heads::One),
        (101, _) => arrow(size, Heads::Narrow),
        (102, _) => arrow(size, Heads::Two),
        (103, _) => Shape::Line {
            width: x * context.line_width,
            length: z,
        },
        (104, _) => Shape::LineBox {
            half_size: size,
            width: BOX_LINES * context.line_width,
        },
        (GEOM_SKIN, _) => Shape::Soft {
            soft: *entry("skin of a geom", &context.softs.skins, object)?,
            size,
        },
        (108, _) => Shape::Triangle { sides: [x, y] },
        // Height fields and meshes without data are shown by nobody; a flex gets its surface later.
        (GEOM_FLEX, _) => Shape::Soft { soft: 0, size },
        (1 | 7 | 8 | 107 | 1001, _) => Shape::Sphere { radius: 0.0 },
        (kind, _) => {
            return Err(Error::Unsupported {
                what: format!("geom type {kind}"),
            });
        }
    })
}

fn arrow(size: [f32; 3], heads: Heads) -> Shape {
    Shape::Arrow { size, heads }
}

/// A plane with the sizes of the model in f64, unless they were changed in the scene.
fn plane_of(record: &Record<'_, GEOM_FIELDS>, context: &Context<'_>) -> Shape {
    let size: [f32; 3] = record.floats(G::Size as usize);
    let object = usize::try_from(record.int(G::ObjId as usize)).unwrap_or(usize::MAX);
    let is_geom = record.int(G::ObjType as usize) == OBJECT_GEOM;
    let exact = context.geom_size.as_chunks::<3>().0.get(object);
    let exact = exact.filter(|exact| is_geom && is_rounded(exact, &size));
    let [x, y, z] = exact.copied().unwrap_or(size.map(f64::from));
    Shape::Plane {
        half_size: [x.max(0.0), y.max(0.0)],
        spacing: z,
    }
}

fn surface_of(record: &Record<'_, GEOM_FIELDS>, context: &Context<'_>) -> Result<Surface> {
    Ok(Surface {
        rgba: record.floats(G::Rgba as usize),
        emission: record.float(G::Emission as usize),
        specular: record.float(G::Specular as usize),
        shininess: record.float(G::Shininess as usize),
        reflectance: record.float(G::Reflectance as usize),
        texture: texture_of(record, context)?,
    })
}

/// The geom's own texture, or that of its material; MuJoCo shows neither without a material.
fn texture_of(
    record: &Record<'_, GEOM_FIELDS>,
    context: &Context<'_>,
) -> Result<Option<TextureUse>> {
    let Ok(material) = usize::try_from(record.int(G::MatId as usize)) else {
        return Ok(None);
    };
    let own = record.places[G::TexId as usize].map(|_| record.int(G::TexId as usize));
    let (texture, uniform, repeat) = match own.and_then(|id| usize::try_from(id).ok()) {
        Some(texture) => (
            Some(texture),
            record.int(G::TexUniform as usize) != 0,
            record.floats(G::TexRepeat as usize),
        ),
        None => (
            usize::try_from(*entry("material", context.material_texture, material)?).ok(),
            *entry("material", context.material_uniform, material)? != 0,
            *entry("material", context.material_repeat.as_chunks().0, material)?,
        ),
    };
    let Some(texture) = texture else {
        return Ok(None);
    };
    let texture = *entry("texture of a material", context.textures, texture)?;
    Ok(texture.map(|texture| TextureUse {
        texture,
        repeat,
        uniform,
    }))
}

/// Entry `index` of a table.
fn entry<'a, T>(what: &'static str, table: &'a [T], index: usize) -> Result<&'a T> {
    let len = table.len();
    table.get(index).ok_or(Error::Index { what, index, len })
}

/// A flex as what it shows: balls, tubes and a surface.
fn push_flex(geom: Geom, object: i32, context: &Context<'_>, geoms: &mut Vec<Geom>) -> Result<()> {
    let object = usize::try_from(object).unwrap_or(usize::MAX);
    let flex = entry("flex of a geom", &context.softs.flexes, object)?;
    let Shape::Soft { size, .. } = geom.shape else {
        return Ok(());
    };
    let plain = Surface {
        texture: None,
        ..geom.surface
    };
    let bare = Geom {
        surface: plain,
        rotation: Geom::new(geom.shape).rotation,
        ..geom
    };
    geoms.extend(flex.balls.iter().map(|at| Geom {
        shape: Shape::Sphere { radius: size[0] },
        position: at.map(f64::from),
        ..bare
    }));
    geoms.extend(flex.edges.iter().map(|&ends| tube(bare, ends, size[0])));
    geoms.extend(flex.surface.map(|soft| Geom {
        shape: Shape::Soft { soft, size },
        ..geom
    }));
    Ok(())
}

/// A tube from one point to another.
#[expect(clippy::cast_possible_truncation, reason = "sizes are f32")]
fn tube(bare: Geom, [from, to]: [[f32; 3]; 2], radius: f32) -> Geom {
    let way = [0, 1, 2].map(|k| f64::from(to[k] - from[k]));
    let length = way.iter().map(|x| x * x).sum::<f64>().sqrt();
    let along = way.map(|x| if length > 0.0 { x / length } else { 0.0 });
    // Any two axes across will do; the helper is the one that it is farthest from.
    let helper = if along[2].abs() < 0.9 {
        [0.0, 0.0, 1.0]
    } else {
        [1.0, 0.0, 0.0]
    };
    let cross = |a: [f64; 3], b: [f64; 3]| {
        [
            a[1] * b[2] - a[2] * b[1],
            a[2] * b[0] - a[0] * b[2],
            a[0] * b[1] - a[1] * b[0],
        ]
    };
    let x = cross(helper, along);
    let norm = x.iter().map(|v| v * v).sum::<f64>().sqrt().max(1e-12);
    let x = x.map(|v| v / norm);
    let y = cross(along, x);
    Geom {
        shape: Shape::Tube {
            radius,
            half_length: (0.5 * length) as f32,
        },
        position: [0, 1, 2].map(|k| f64::midpoint(f64::from(from[k]), f64::from(to[k]))),
        rotation: std::array::from_fn(|i| [x, y, along][i % 3][i / 3]),
        ..bare
    }
}

/// Appends the lights of `records`, `stride` bytes each; those that MuJoCo's renderer ignores are left out.
pub(crate) fn read_lights(
    records: &[u8],
    stride: usize,
    places: &Places<LIGHT_FIELDS>,
    lights: &mut Vec<Light>,
) {
    for bytes in records.chunks_exact(stride) {
        let record = Record { bytes, places };
        let is_parallel = record.flag(L::Directional as usize, false);
        let kind = match record.int(L::Type as usize) {
            _ if is_parallel => LightKind::Directional,
            LIGHT_DIRECTIONAL => LightKind::Directional,
            LIGHT_SPOT => LightKind::Spot {
                attenuation: record.floats(L::Attenuation as usize),
                exponent: record.float(L::Exponent as usize),
                cutoff: record.float(L::Cutoff as usize),
            },
            _ => continue,
        };
        lights.push(Light {
            kind,
            ambient: record.floats(L::Ambient as usize),
            diffuse: record.floats(L::Diffuse as usize),
            specular: record.floats(L::Specular as usize),
            position: record.floats(L::Pos as usize),
            direction: record.floats(L::Dir as usize),
            is_headlight: record.flag(L::Headlight as usize, false),
            casts_shadow: record.flag(L::CastShadow as usize, false),
        });
    }
}
