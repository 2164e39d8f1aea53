//! What scenes, views and canvases refuse, and how they say it.

use super::*;

#[test]
fn every_refusal_says_what_was_expected_and_found() {
    let scene = mixed_scene(1);
    let mut view = View::new(&scene, camera([0.0; 3], 0.0, 0.0)).unwrap();
    let poses = vec![0.0; 3];
    let refusals = [
        (
            Canvas::new(0, 4, Antialias::Off).err(),
            "picture height: expected 1 to 8192, got 0",
        ),
        (
            view.set_poses(4, &[0.0; 6], &[0.0; 18]).err(),
            "geom positions: expected 3 values, got 6",
        ),
        (
            view.set_poses(6, &[], &[]).err(),
            "first geom index 6: expected less than 6",
        ),
        (
            view.set_poses(0, &poses, &[0.0; 8]).err(),
            "geom rotations: expected 9 values, got 8",
        ),
        (
            view.set_poses(1, &[f64::NAN; 3], &UPRIGHT).err(),
            "pose of geom 1: expected finite numbers, got NaN or infinity",
        ),
        (
            view.set_visible(&[true]).err(),
            "visibility of geoms: expected 5 values, got 1",
        ),
        (
            view.set_light(7, true, [0.0; 3], [0.0; 3]).err(),
            "light index 7: expected less than 2",
        ),
        (
            view.set_camera(camera([f64::NAN; 3], 0.0, 0.0)).err(),
            "camera 0: expected finite numbers, got NaN or infinity",
        ),
        (
            Texture::new(TextureKind::Flat, 2, 2, 2, &[0; 8]).err(),
            "texture channels: expected 3 or 4, got 2",
        ),
        (
            Texture::new(TextureKind::Cube, 2, 3, 3, &[0; 18]).err(),
            "cube texture height: expected the width, or six times the width, got 3 for width 2",
        ),
    ];
    for (error, message) in refusals {
        assert_eq!(
            error.as_ref().map(Error::to_string).as_deref(),
            Some(message)
        );
    }
    let spec = SceneSpec {
        sky: Some(0),
        far: 1.0,
        ..SceneSpec::default()
    };
    assert_eq!(
        Scene::new(spec).err(),
        Some(Error::Index {
            what: "sky texture",
            index: 0,
            len: 0
        })
    );
}

#[test]
fn numbers_without_meaning_are_refused_wherever_a_scene_has_them() {
    let refused = |change: fn(&mut SceneSpec)| {
        let mut spec = mixed_scene(1).spec;
        change(&mut spec);
        Scene::new(spec).err().map(|error| error.to_string())
    };
    let told = |what: &str| {
        Some(format!(
            "{what}: expected finite numbers, got NaN or infinity"
        ))
    };
    assert_eq!(
        refused(|spec| spec.lights[1].diffuse[2] = f32::NAN),
        told("light 1")
    );
    let spot = |spec: &mut SceneSpec| {
        spec.lights[1].kind = LightKind::Spot {
            attenuation: [1.0, f32::INFINITY, 0.0],
            exponent: 5.0,
            cutoff: 60.0,
        };
    };
    assert_eq!(refused(spot), told("light 1"));
    let haze = |spec: &mut SceneSpec| {
        spec.haze = Some(Haze {
            rgb: [f32::NAN; 3],
            proportion: 0.5,
        });
    };
    assert_eq!(refused(haze), told("haze 0"));
    let repeat = |spec: &mut SceneSpec| {
        if let Some(texture) = &mut spec.geoms[3].surface.texture {
            texture.repeat[0] = f32::NAN;
        }
    };
    assert_eq!(refused(repeat), told("texture repetitions of geom 3"));
}

#[test]
fn a_view_is_of_its_own_scene_and_of_a_camera_that_sees() {
    let ball = Geom {
        shape: Shape::Sphere { radius: 0.4 },
        surface: Surface::default(),
        tag: [0, 5],
    };
    let scene = |geoms| {
        Scene::new(SceneSpec {
            geoms,
            far: 20.0,
            ..SceneSpec::default()
        })
        .unwrap()
    };
    let (one, two) = (scene(vec![ball]), scene(vec![ball, ball]));
    let view = View::new(&one, camera([-2.0, 0.0, 0.0], 0.0, 0.0)).unwrap();
    let mut canvas = Canvas::new(4, 4, Antialias::Off).unwrap();
    let refused = Err(Error::Length {
        what: "poses of the view",
        expected: 2,
        got: 1,
    });
    let draw = canvas.draw(&two, &view, Layout::Interleaved, &mut [0; 48]);
    assert_eq!(draw, refused);
    assert_eq!(canvas.draw_depth(&two, &view, &mut [0.0; 16]), refused);
    assert_eq!(canvas.draw_tags(&two, &view, &mut [0; 32]), refused);
    let blind = Camera {
        lens: Lens::Angle { fovy: f64::NAN },
        ..camera([0.0; 3], 0.0, 0.0)
    };
    assert!(View::new(&one, blind).is_err());
}
