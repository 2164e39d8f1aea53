//! Properties of pictures, against a reference that follows one ray a pixel.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod refusals;

use std::sync::Arc;

use proptest::prelude::*;

use crate::lanes::Kind;
use crate::{
    Antialias, Camera, Canvas, Effects, Fog, Geom, Haze, Heads, Layout, Lens, Light, LightKind,
    MeshData, Scene, SceneSpec, Shape, Surface, Texture, TextureKind, TextureUse, View,
};

const SIZE: usize = 40;
const NEAR: f32 = 0.05;
const FAR: f32 = 20.0;

/// A view of a scene without assets.
fn view_of(geoms: &[Geom], camera: Camera) -> View {
    let spec = SceneSpec {
        far: f64::from(FAR),
        ..SceneSpec::default()
    };
    let mut view = View::new(Arc::new(Scene::new(spec).unwrap()), camera).unwrap();
    view.set_geoms(geoms, &[]).unwrap();
    view
}

fn camera(position: [f64; 3], azimuth: f64, elevation: f64) -> Camera {
    let [_, forward, up] = Camera::orbit([0.0; 3], 1.0, azimuth, elevation);
    Camera {
        position,
        forward,
        up,
        lens: Lens::Angle { fovy: 70.0 },
        near: NEAR,
        far: FAR,
    }
}

fn canvas(antialias: Antialias, kind: Kind) -> Canvas {
    let mut canvas = Canvas::new(SIZE, SIZE, antialias).unwrap();
    canvas.use_kind(kind);
    canvas
}

/// Every kind of machine that this one can play.
fn kinds() -> Vec<Kind> {
    let mut kinds = vec![Kind::Plain];
    #[cfg(target_arch = "x86_64")]
    {
        if Kind::detect() == Kind::Avx512 {
            kinds.push(Kind::Avx512);
        }
        if std::arch::is_x86_feature_detected!("avx2") {
            kinds.push(Kind::Avx2);
        }
    }
    kinds
}

fn picture(view: &View, antialias: Antialias, kind: Kind) -> Vec<u8> {
    let mut out = vec![0; 3 * SIZE * SIZE];
    canvas(antialias, kind)
        .draw(view, Layout::Interleaved, &mut out)
        .unwrap();
    out
}

/// A mesh of separate triangles.
fn soup(triangles: &[[[f32; 3]; 3]]) -> MeshData {
    let count = u32::try_from(triangles.len()).unwrap();
    let faces: Vec<[u32; 3]> = (0..count).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    MeshData {
        vertices: triangles.iter().flatten().copied().collect(),
        normals: vec![[0.0, 0.0, 1.0]],
        face_normals: vec![[0; 3]; faces.len()],
        faces,
        ..MeshData::default()
    }
}

/// A view of one mesh.
fn mesh_view(mesh: MeshData, camera: Camera) -> View {
    let shape = Shape::Mesh {
        mesh: 0,
        half_size: [1.0; 3],
    };
    let spec = SceneSpec {
        meshes: vec![mesh],
        far: f64::from(FAR),
        ..SceneSpec::default()
    };
    let mut view = View::new(Arc::new(Scene::new(spec).unwrap()), camera).unwrap();
    view.set_geoms(&[Geom::new(shape)], &[]).unwrap();
    view
}

/// Distance along the gaze at which the ray through the middle of a pixel meets the front of a triangle, and how far
/// from its edges, as the smallest of its three weights (Moller and Trumbore 1997, in f64).
fn meet(camera: &Camera, x: usize, y: usize, triangle: &[[f32; 3]; 3]) -> Option<(f64, f64)> {
    let cross = |a: [f64; 3], b: [f64; 3]| {
        [
            a[1] * b[2] - a[2] * b[1],
            a[2] * b[0] - a[0] * b[2],
            a[0] * b[1] - a[1] * b[0],
        ]
    };
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let tan = 35.0_f64.to_radians().tan();
    let across =
        |i: usize| (2.0 * (f64::from(u16::try_from(i).unwrap()) + 0.5) / f64::from(40) - 1.0) * tan;
    let right = cross(camera.forward, camera.up);
    let ray =
        [0, 1, 2].map(|k| camera.forward[k] + across(x) * right[k] - across(y) * camera.up[k]);
    let p = triangle.map(|v| [0, 1, 2].map(|k| f64::from(v[k]) - camera.position[k]));
    let (a, b) = (
        [0, 1, 2].map(|k| p[1][k] - p[0][k]),
        [0, 1, 2].map(|k| p[2][k] - p[0][k]),
    );
    let volume = -dot(cross(a, b), ray);
    if volume <= 1e-9 {
        return None;
    }
    let distance = -dot(p[0], cross(a, b)) / volume;
    let hit = ray.map(|r| r * distance);
    let to = [0, 1, 2].map(|k| hit[k] - p[0][k]);
    let normal = cross(a, b);
    let area = dot(normal, normal);
    let (s, t) = (
        dot(cross(to, b), normal) / area,
        dot(cross(a, to), normal) / area,
    );
    Some((distance, s.min(t).min(1.0 - s - t)))
}

fn triangles() -> impl Strategy<Value = Vec<[[f32; 3]; 3]>> {
    let corner = prop::array::uniform3(-3.0_f32..3.0);
    prop::collection::vec(prop::array::uniform3(corner), 1..12)
}

fn anywhere() -> impl Strategy<Value = Camera> {
    (
        prop::array::uniform3(-2.0_f64..2.0),
        0.0..360.0,
        -80.0..80.0,
    )
        .prop_map(|(p, a, e)| camera(p, a, e))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    /// Triangles all around the camera, through its near plane and through each other.
    #[test]
    fn distances_are_those_of_rays(triangles in triangles(), camera in anywhere()) {
        let view = mesh_view(soup(&triangles), camera);
        for kind in kinds() {
            let mut depth = vec![0.0; SIZE * SIZE];
            canvas(Antialias::Off, kind).draw_depth(&view, &mut depth).unwrap();
            for (i, &found) in depth.iter().enumerate() {
                let hits: Vec<_> = (triangles.iter().filter_map(|t| meet(&camera, i % SIZE, i / SIZE, t)))
                    .filter(|&(distance, _)| distance > 0.0)
                    .collect();
                // Pixels near an edge, or near one of the clipping planes, may fall on either side.
                let is_unsure = hits.iter().any(|&(distance, inside)| {
                    inside.abs() < 1e-3 || (distance / f64::from(NEAR) - 1.0).abs() < 1e-2
                });
                if is_unsure {
                    continue;
                }
                let expected = (hits.iter().filter(|&&(d, inside)| inside > 0.0 && d > f64::from(NEAR)))
                    .map(|&(distance, _)| distance)
                    .fold(f64::from(FAR), f64::min);
                prop_assert!((f64::from(found) / expected - 1.0).abs() < 1e-3, "{} instead of {}", found, expected);
            }
        }
    }

    /// A closed surface has no holes and no pixel drawn twice: through a half clear ball one sees it once.
    #[test]
    fn neighbours_share_no_sample_and_lose_none(distance in 0.8_f64..4.0, azimuth in 0.0..360.0, elevation in -89.0..89.0) {
        let surface = Surface { rgba: [1.0, 1.0, 1.0, 0.5], emission: 1.0, specular: 0.0, ..Surface::default() };
        let ball = Geom { surface, ..Geom::new(Shape::Sphere { radius: 0.5 }) };
        let [position, forward, up] = Camera::orbit([0.0; 3], distance, azimuth, elevation);
        let camera = Camera { position, forward, up, lens: Lens::Angle { fovy: 40.0 }, near: NEAR, far: FAR };
        let mut view = view_of(&[ball], camera);
        view.set_lights(&[light(LightKind::Directional, 0.0)]).unwrap();
        let out = picture(&view, Antialias::Off, Kind::detect());
        // Blended over black twice, as transparent geoms are: 128, then 128 + 64.
        for pixel in out.chunks_exact(3) {
            prop_assert!(pixel[0] == 0 || (191..=192).contains(&pixel[0]), "{:?}", pixel);
        }
        prop_assert!(out[3 * (SIZE / 2 * SIZE + SIZE / 2)] > 0);
    }

    /// Vector units change the speed, not the picture.
    #[test]
    fn machines_agree_to_the_last_bit(camera in anywhere(), seed in 0_u8..255) {
        let mut geoms = mixed_geoms();
        let places = [[1.5, 0.0, 0.0], [0.0, 1.5, 0.3], [-1.5, 0.0, 0.0], [0.0, -1.5, 0.5], [0.0, 0.0, -1.0]];
        for (geom, place) in geoms.iter_mut().zip(places) {
            geom.position = place;
        }
        geoms[4].surface.reflectance = 0.5;
        let mut view = mixed_view(seed, None, camera);
        view.set_geoms(&geoms, &[]).unwrap();
        view.set_effects(Effects { has_fog: true, ..Effects::default() });
        for antialias in [Antialias::Off, Antialias::Multisample, Antialias::Supersample] {
            let expected = picture(&view, antialias, Kind::Plain);
            for kind in kinds() {
                prop_assert_eq!(&picture(&view, antialias, kind), &expected);
            }
        }
    }

    /// Sizes of zero, huge and tiny ones, cameras inside: something or nothing, but no panic.
    #[test]
    fn any_size_makes_a_picture(
        sizes in prop::array::uniform3(prop_oneof![Just(0.0_f32), Just(1e-30), Just(1e20), 0.0_f32..3.0]),
        camera in anywhere(),
    ) {
        let [radius, half_length, _] = sizes;
        let shapes = [
            Shape::Sphere { radius },
            Shape::Capsule { radius, half_length },
            Shape::Ellipsoid { radii: sizes },
            Shape::Cylinder { radius, half_length },
            Shape::Box { half_size: sizes },
            Shape::Plane { half_size: [radius.into(), half_length.into()], spacing: 0.1 },
            Shape::Arrow { size: sizes, heads: Heads::One },
            Shape::Arrow { size: sizes, heads: Heads::Narrow },
            Shape::Arrow { size: sizes, heads: Heads::Two },
            Shape::Triangle { sides: [radius, half_length] },
            Shape::Line { width: radius, length: half_length },
            Shape::LineBox { half_size: sizes, width: 2.0 },
        ];
        for shape in shapes {
            let mut geom = Geom::new(shape);
            geom.surface.reflectance = 0.5;
            let mut view = view_of(&[geom, Geom::new(Shape::Sphere { radius: 0.3 })], camera);
            view.set_lights(&[still(LightKind::Directional), still(SPOT)]).unwrap();
            picture(&view, Antialias::Multisample, Kind::detect());
        }
    }
}

/// A light from the camera's side that lights nothing but what it is told to.
fn light(kind: LightKind, strength: f32) -> Light {
    Light {
        kind,
        ambient: [0.2 * strength; 3],
        diffuse: [0.6 * strength; 3],
        specular: [0.4 * strength; 3],
        position: [0.0; 3],
        direction: [0.0, 0.0, -1.0],
        is_headlight: true,
        casts_shadow: false,
    }
}

const SPOT: LightKind = LightKind::Spot {
    attenuation: [1.0, 0.1, 0.0],
    exponent: 5.0,
    cutoff: 60.0,
};

/// A light that hangs above the middle and casts shadows.
fn still(kind: LightKind) -> Light {
    Light {
        position: [0.2, 0.1, 3.0],
        is_headlight: false,
        casts_shadow: true,
        ..light(kind, 1.0)
    }
}

/// Flat and cube textures of noise, the cube as the sky, and fog.
fn mixed_spec(seed: u8) -> SceneSpec {
    let noise = |n: usize| -> Vec<u8> {
        let next = |x: &mut u32| {
            *x = x.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            Some(x.to_le_bytes()[3])
        };
        std::iter::repeat_with({
            let mut x = u32::from(seed);
            move || next(&mut x).unwrap()
        })
        .take(n)
        .collect()
    };
    let flat = Texture::new(TextureKind::Flat, 48, 20, 3, &noise(48 * 20 * 3)).unwrap();
    let cube = Texture::new(TextureKind::Cube, 16, 96, 3, &noise(16 * 96 * 3)).unwrap();
    SceneSpec {
        textures: vec![flat, cube],
        sky: Some(1),
        fog: Some(Fog {
            rgb: [0.4, 0.5, 0.6],
            start: 1.0,
            end: 9.0,
        }),
        far: f64::from(FAR),
        ..SceneSpec::default()
    }
}

/// One of each common shape, with both kinds of texture.
fn mixed_geoms() -> Vec<Geom> {
    let (radius, half_length) = (0.4, 0.5);
    let half_size = [0.3, 0.5, 0.4];
    let endless = Shape::Plane {
        half_size: [0.0, 0.0],
        spacing: 0.1,
    };
    let shapes = [
        (Shape::Box { half_size }, Some(0)),
        (Shape::Sphere { radius }, Some(1)),
        (
            Shape::Cylinder {
                radius,
                half_length,
            },
            None,
        ),
        (
            Shape::Capsule {
                radius,
                half_length,
            },
            Some(0),
        ),
        (endless, Some(0)),
    ];
    let painted = |(shape, texture): (Shape, Option<usize>)| {
        let texture = texture.map(|texture| TextureUse {
            texture,
            repeat: [3.0, 2.0],
            uniform: true,
        });
        let surface = Surface {
            texture,
            ..Surface::default()
        };
        Geom {
            surface,
            ..Geom::new(shape)
        }
    };
    shapes.into_iter().map(painted).collect()
}

/// One of each common shape, with both kinds of texture and light.
fn mixed_view(seed: u8, haze: Option<Haze>, camera: Camera) -> View {
    let mut spec = mixed_spec(seed);
    spec.haze = haze;
    let mut view = View::new(Arc::new(Scene::new(spec).unwrap()), camera).unwrap();
    view.set_geoms(&mixed_geoms(), &[]).unwrap();
    view.set_lights(&[light(LightKind::Directional, 1.0), still(SPOT)])
        .unwrap();
    view
}

#[test]
fn a_camera_inside_a_solid_looks_through_it() {
    let shapes = [
        Shape::Sphere { radius: 1.0 },
        Shape::Box {
            half_size: [1.0; 3],
        },
    ];
    for shape in shapes {
        let view = view_of(&[Geom::new(shape)], camera([0.1, 0.0, 0.0], 30.0, 10.0));
        let mut tags = vec![0; 2 * SIZE * SIZE];
        canvas(Antialias::Off, Kind::detect())
            .draw_tags(&view, &mut tags)
            .unwrap();
        assert!(tags.iter().all(|&t| t == -1));
    }
}

#[test]
fn triangles_without_area_are_not_drawn() {
    let line = [[0.0, 1.0, 0.0], [0.0, 2.0, 0.0], [0.0, 3.0, 0.0]];
    let point = [[0.0, 1.0, 0.0]; 3];
    let view = mesh_view(soup(&[line, point]), camera([0.0, -1.0, 0.1], 90.0, 0.0));
    let mut tags = vec![0; 2 * SIZE * SIZE];
    canvas(Antialias::Off, Kind::detect())
        .draw_tags(&view, &mut tags)
        .unwrap();
    assert!(tags.iter().all(|&t| t == -1));
}

#[test]
fn averaging_four_samples_rounds_to_the_nearest() {
    // A white ball against black: every level in between must be one of the five means of four samples.
    let surface = Surface {
        rgba: [1.0; 4],
        emission: 1.0,
        specular: 0.0,
        ..Surface::default()
    };
    let ball = Geom {
        surface,
        ..Geom::new(Shape::Sphere { radius: 0.5 })
    };
    let view = view_of(&[ball], camera([-2.0, 0.0, 0.0], 0.0, 0.0));
    for antialias in [Antialias::Multisample, Antialias::Supersample] {
        let out = picture(&view, antialias, Kind::detect());
        let levels: std::collections::BTreeSet<u8> = out.into_iter().collect();
        assert!(
            levels
                .iter()
                .all(|level| [0, 64, 128, 191, 255].contains(level)),
            "{levels:?}"
        );
        assert!(levels.len() >= 4, "edges are smoothed: {levels:?}");
    }
}

#[test]
fn a_ball_keeps_the_light_of_its_lamp_from_the_floor_below() {
    let half_size = [2.0, 2.0];
    let floor = Geom::new(Shape::Plane {
        half_size,
        spacing: 0.1,
    });
    let ball = Geom {
        position: [0.0, 0.0, 1.0],
        ..Geom::new(Shape::Sphere { radius: 0.5 })
    };
    let clear = Geom {
        casts_shadow: false,
        ..ball
    };
    // From the side, so that the floor below the ball is seen.
    let look = |geom: Geom, has_shadows: bool| {
        let mut view = view_of(&[floor, geom], camera([-2.0, 0.0, 0.6], 0.0, -16.0));
        view.set_lights(&[still(LightKind::Directional)]).unwrap();
        let effects = Effects {
            has_shadows,
            ..Effects::default()
        };
        view.set_effects(effects);
        picture(&view, Antialias::Off, Kind::detect())
    };
    let (shaded, lit) = (look(ball, true), look(ball, false));
    assert!(shaded != lit);
    assert!(shaded.iter().zip(&lit).all(|(a, b)| a <= b));
    assert!(look(clear, true) == lit);
}

#[test]
fn haze_brighter_than_white_is_white() {
    let look = |rgb| {
        let proportion = 0.8;
        let haze = Some(Haze { rgb, proportion });
        let view = mixed_view(1, haze, camera([0.0, 0.0, 1.0], 0.0, 0.0));
        picture(&view, Antialias::Off, Kind::detect())
    };
    let white = look([1.0; 3]);
    assert_ne!(white, look([0.0; 3]), "the haze is in the picture");
    assert!(white == look([1.5, 1.0, 700.0]));
}

#[test]
fn a_light_that_does_not_fall_off_to_begin_with_makes_no_strange_colours() {
    let green = Light {
        kind: LightKind::Spot {
            attenuation: [0.0; 3],
            exponent: 0.0,
            cutoff: 180.0,
        },
        ambient: [0.0, 1.0, 0.0],
        is_headlight: false,
        ..light(LightKind::Directional, 0.0)
    };
    let mut view = mixed_view(1, None, camera([-2.0, 0.0, 1.0], 0.0, -20.0));
    view.set_lights(&[light(LightKind::Directional, 1.0), green])
        .unwrap();
    let kinds = kinds();
    let pictures: Vec<_> = kinds
        .iter()
        .map(|&kind| picture(&view, Antialias::Off, kind))
        .collect();
    // Without end in green, so all that is lit by it is as green as can be.
    let ball = 3 * (SIZE * SIZE / 2 + SIZE / 2);
    assert!(pictures.iter().all(|picture| *picture == pictures[0]));
    assert!(
        pictures[0][ball + 1] >= pictures[0][ball],
        "{:?}",
        &pictures[0][ball..ball + 3]
    );
}
