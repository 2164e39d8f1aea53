//! A software renderer for small pictures of scenes made of simple solids and meshes.
//!
//! Scene in, pixels out: no graphics driver, no window system, no global state. The pictures follow what MuJoCo's
//! OpenGL renderer draws, and are the same to the last bit on every machine: plain
//! IEEE arithmetic in a fixed order, no fused operations, no dependence on vector width or threads.
//!
//! ```
//! use std::sync::Arc;
//! use vhs_raster::{Antialias, Camera, Canvas, Geom, Layout, Lens, Scene, SceneSpec, Shape, View};
//!
//! # fn main() -> vhs_raster::Result<()> {
//! let scene = Arc::new(Scene::new(SceneSpec { far: 10.0, ..SceneSpec::default() })?);
//! let camera = Camera {
//!     position: [0.0, -2.0, 0.0],
//!     forward: [0.0, 1.0, 0.0],
//!     up: [0.0, 0.0, 1.0],
//!     lens: Lens::Angle { fovy: 45.0 },
//!     near: 0.01,
//!     far: 10.0,
//! };
//! let mut view = View::new(scene, camera)?;
//! view.set_geoms(&[Geom::new(Shape::Sphere { radius: 0.5 })], &[])?;
//! let mut canvas = Canvas::new(64, 64, Antialias::Off)?;
//! let mut picture = vec![0; 64 * 64 * 3];
//! canvas.draw(&view, Layout::Interleaved, &mut picture)?;
//! assert!(picture[3 * (32 * 64 + 32)] > 0, "the ball is in the middle");
//! assert_eq!(picture[0], 0, "and not in the corner");
//! # Ok(())
//! # }
//! ```
#![deny(missing_docs)]
#![allow(clippy::doc_markdown, reason = "MuJoCo and OpenGL are names, not code")]
#![allow(
    clippy::float_cmp,
    reason = "numbers are compared with values that are kept exactly, or with themselves"
)]
#![allow(
    clippy::inline_always,
    reason = "code over `lanes::Machine` gets its instruction set from the function it is inlined into"
)]
#![allow(
    clippy::many_single_char_names,
    reason = "x, y, u, v, w are what the literature calls them"
)]
#![allow(
    clippy::needless_range_loop,
    reason = "loops over axes and channels read better by number"
)]

mod assets;
mod batch;
mod camera;
mod canvas;
mod cover;
mod error;
mod fill;
mod frame;
mod lanes;
mod light;
mod math;
mod mirror;
mod nodes;
mod output;
mod paint;
mod parts;
mod round;
mod scene;
mod shade;
mod shadow;
mod solid;
mod surfaces;
#[cfg(test)]
mod tests;
mod texture;
mod view;

pub use assets::Scene;
pub use batch::draw_all;
pub use camera::{Camera, Lens};
pub use canvas::{Antialias, Canvas};
pub use error::{Error, Result};
pub use output::Layout;
pub use scene::{
    Fog, Geom, Haze, Heads, HeightField, Light, LightKind, MeshData, SceneSpec, Shadows, Shape,
    Soft, Surface, Tessellation, TextureUse,
};
pub use texture::{Texture, TextureKind};
pub use view::{Effects, View};
