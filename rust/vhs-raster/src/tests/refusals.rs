//! What scenes, views and canvases refuse, and how they say it.

use super::*;
use crate::{HeightField, Soft};

fn told<T>(result: crate::Result<T>) -> String {
    result.err().map(|e| e.to_string()).unwrap_or_default()
}

fn not_finite(what: &str) -> String {
    format!("{what}: expected finite numbers, got NaN or infinity")
}

#[test]
fn every_refusal_of_a_size_says_what_was_expected_and_found() {
    assert_eq!(
        told(Canvas::new(0, 4, Antialias::Off)),
        "picture height: expected 1 to 8192, got 0"
    );
    assert_eq!(
        told(Texture::new(TextureKind::Flat, 2, 2, 2, &[0; 8])),
        "texture channels: expected 3 or 4, got 2"
    );
    assert_eq!(
        told(Texture::new(TextureKind::Cube, 2, 3, 3, &[0; 18])),
        "cube texture height: expected the width, or six times the width, got 3 for width 2"
    );
    let mut view = view_of(&[], camera([0.0; 3], 0.0, 0.0));
    assert_eq!(
        told(view.set_camera(camera([f64::NAN; 3], 0.0, 0.0))),
        not_finite("camera 0")
    );
    let blind = Camera {
        lens: Lens::Angle { fovy: f64::NAN },
        ..camera([0.0; 3], 0.0, 0.0)
    };
    assert!(View::new(view.scene.clone(), blind).is_err());
}

#[test]
fn scenes_refuse_what_makes_no_picture() {
    let refused = |change: fn(&mut SceneSpec)| {
        let mut spec = mixed_spec(1);
        change(&mut spec);
        told(Scene::new(spec))
    };
    assert_eq!(
        refused(|spec| spec.sky = Some(2)),
        "sky texture index 2: expected less than 2"
    );
    assert_eq!(
        refused(|spec| spec.sky = Some(0)),
        "not drawn by this renderer: a sky that is not a cube texture"
    );
    let haze = |spec: &mut SceneSpec| {
        spec.haze = Some(Haze {
            rgb: [f32::NAN; 3],
            proportion: 0.5,
        });
    };
    assert_eq!(refused(haze), not_finite("haze 0"));
    let narrow = |spec: &mut SceneSpec| {
        spec.height_fields.push(HeightField {
            rows: 1,
            columns: 3,
            ..HeightField::default()
        });
    };
    assert_eq!(
        refused(narrow),
        "height field: expected at least 2 rows and 2 columns, got 1 and 3"
    );
    let high = |spec: &mut SceneSpec| {
        spec.height_fields.push(HeightField {
            rows: 2,
            columns: 2,
            size: [1.0; 4],
            heights: vec![0.0, 0.0, f32::NAN, 0.0],
        });
    };
    assert_eq!(refused(high), not_finite("height 2"));
}

#[test]
fn geoms_and_lights_without_meaning_are_refused_and_the_last_ones_stay() {
    let mut view = mixed_view(1, None, camera([-2.0, 0.0, 1.0], 0.0, -20.0));
    let before = picture(&view, Antialias::Off, Kind::detect());
    let mut refused = |change: fn(&mut Vec<Geom>)| {
        let mut geoms = mixed_geoms();
        change(&mut geoms);
        told(view.set_geoms(&geoms, &[]))
    };
    assert_eq!(
        refused(|geoms| geoms[1].position[2] = f64::NAN),
        not_finite("pose of geom 1")
    );
    assert_eq!(
        refused(|geoms| geoms[2].surface.rgba[0] = f32::INFINITY),
        not_finite("surface or size of geom 2")
    );
    let repeat = |geoms: &mut Vec<Geom>| {
        if let Some(texture) = &mut geoms[3].surface.texture {
            texture.repeat[0] = f32::NAN;
        }
    };
    assert_eq!(refused(repeat), not_finite("texture repetitions of geom 3"));
    let mesh = |geoms: &mut Vec<Geom>| {
        geoms[0].shape = Shape::Mesh {
            mesh: 3,
            half_size: [1.0; 3],
        };
    };
    assert_eq!(refused(mesh), "mesh index 3: expected less than 0");
    let soft = |geoms: &mut Vec<Geom>| {
        geoms[0].shape = Shape::Soft {
            soft: 0,
            size: [1.0; 3],
        };
    };
    assert_eq!(refused(soft), "soft index 0: expected less than 0");
    let torn = Soft {
        vertices: vec![[0.0; 3]; 3],
        normals: vec![[0.0; 3]; 3],
        faces: vec![[0, 1, 3]],
        ..Soft::default()
    };
    assert_eq!(
        told(view.set_geoms(&mixed_geoms(), &[torn])),
        "soft vertex index 3: expected less than 3"
    );
    let dark = Light {
        diffuse: [f32::NAN; 3],
        ..light(LightKind::Directional, 1.0)
    };
    let lights = [light(LightKind::Directional, 1.0), dark];
    assert_eq!(told(view.set_lights(&lights)), not_finite("light 1"));
    assert!(picture(&view, Antialias::Off, Kind::detect()) == before);
}
