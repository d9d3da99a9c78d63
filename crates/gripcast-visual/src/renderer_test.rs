use glam::DVec3;

use super::super::env_map::EnvMap;
use super::super::material::{Colour, Material};
use super::super::scene::Mesh;
use super::super::settings::PixelFilter;
use super::super::shading::{Projection, shaded_mesh};
use super::super::texture::Bitmap;
use super::*;
use gripcast_geometry::{Pose, builtin};

const SIZE: usize = 24;

fn camera() -> Camera {
    let eye = DVec3::new(0.12, -0.1, 0.08);
    let pose = Camera::look_at(eye, DVec3::ZERO).unwrap();
    Camera::centred(SIZE, SIZE, 0.35, pose)
}

/// Environment map with a gradient and a bright spot.
fn env_map() -> EnvMap {
    let mut map = Image::filled(32, 16, [0.4, 0.5, 0.6]);
    for (at, pixel) in map.pixels.iter_mut().enumerate() {
        *pixel = pixel.map(|v| v * (1.5 - at as f32 / 512.0));
    }
    map.pixels[5 * 32 + 20] = [60.0, 50.0, 40.0];
    EnvMap::new(map)
}

/// A ball on the ground.
fn scene(material: Material, env_map: EnvMap) -> Scene {
    let sphere = builtin("sphere").unwrap();
    let mut ball = shaded_mesh(&sphere, 4.0, Projection::None, 0);
    ball.normals = ball.positions.iter().map(|p| p.normalize()).collect();
    Scene {
        meshes: vec![
            ball,
            Mesh::ground(Vec3::new(0.0, 0.0, -0.026), 0.3, 0.05, 1),
        ],
        materials: vec![material, Material::grey(0.5)],
        textures: Vec::new(),
        env_map,
        camera: camera(),
    }
}

fn settings(samples: u32) -> RenderSettings {
    RenderSettings {
        samples_per_pixel: samples,
        filter: PixelFilter::Box,
        ..RenderSettings::default()
    }
}

fn render(scene: &Scene, settings: &RenderSettings) -> Rendering {
    let renderer = Renderer::new(scene).unwrap();
    renderer
        .render(&scene.camera, settings, &RenderControl::default())
        .unwrap()
}

fn in_pool(threads: usize, work: impl FnOnce() -> Rendering + Send) -> Rendering {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    pool.unwrap().install(work)
}

#[test]
fn result_does_not_depend_on_thread_count() {
    let scene = scene(Material::grey(0.7), env_map());
    let settings = settings(4);
    let one = in_pool(1, || render(&scene, &settings));
    let two = in_pool(2, || render(&scene, &settings));
    assert_eq!(one, two);
    let other = render(
        &scene,
        &RenderSettings {
            seed: 1,
            ..settings
        },
    );
    assert_ne!(one.image, other.image);
}

#[test]
fn white_materials_pass_the_furnace_test() {
    let metal = Material::Conductor {
        eta: [0.0; 3],
        k: [1.0; 3],
        roughness: 0.5,
    };
    let glass = |roughness| Material::Dielectric {
        ior: 1.5,
        roughness,
        transmittance: [1.0; 3],
    };
    let plastic = Material::Principled {
        base_colour: Colour::Constant([1.0; 3]),
        metallic: 0.2,
        roughness: 0.3,
        ior: 1.5,
    };
    for material in [Material::grey(1.0), metal, plastic, glass(0.0), glass(0.4)] {
        let mut scene = scene(material, EnvMap::uniform([1.0; 3]));
        scene.meshes.pop();
        // Flat faces: the shading normals of smooth ones lose a little at the rim.
        scene.meshes[0].normals.clear();
        let settings = RenderSettings {
            max_bounces: 1000,
            rr_depth: 1000,
            ..settings(64)
        };
        let rendering = render(&scene, &settings);
        // The ball only: its surroundings are exact.
        let pixels = rendering.image.pixels.iter().zip(&rendering.depth_m);
        let ball: Vec<f64> = pixels
            .filter(|(_, depth)| **depth > 0.0)
            .map(|(pixel, _)| f64::from(pixel[0]))
            .collect();
        let mean = ball.iter().sum::<f64>() / ball.len() as f64;
        // Rough glass by interpolated tables, several times along a path.
        assert!((mean - 1.0).abs() < 5e-3, "{material:?}: {mean}");
        let ball = ball.len();
        assert!(ball > SIZE * SIZE / 3);
    }
}

#[test]
fn light_sampling_strategies_have_equal_means() {
    for material in [
        Material::grey(0.8),
        Material::Principled {
            base_colour: Colour::Constant([0.8, 0.4, 0.2]),
            metallic: 0.3,
            roughness: 0.6,
            ior: 1.5,
        },
    ] {
        let scene = scene(material, env_map());
        let mean = |strategy| {
            let mut renderer = Renderer::new(&scene).unwrap();
            renderer.strategy = strategy;
            let rendering =
                renderer.render(&scene.camera, &settings(256), &RenderControl::default());
            rendering.unwrap().image.mean()
        };
        let both = mean(LightSampling::Mis);
        for strategy in [LightSampling::Light, LightSampling::Bsdf] {
            let one = mean(strategy);
            for k in 0..3 {
                assert!(
                    (one[k] / both[k] - 1.0).abs() < 0.015,
                    "{strategy:?}: {one:?} {both:?}"
                );
            }
        }
    }
}

#[test]
fn roulette_and_sample_count_do_not_bias() {
    let scene = scene(Material::grey(0.9), env_map());
    let mean = |settings: &RenderSettings| render(&scene, settings).image.mean();
    let plain = mean(&RenderSettings {
        rr_depth: 100,
        ..settings(256)
    });
    let roulette = mean(&RenderSettings {
        rr_depth: 1,
        ..settings(256)
    });
    let odd = mean(&settings(173));
    for k in 0..3 {
        assert!((roulette[k] / plain[k] - 1.0).abs() < 0.01);
        assert!((odd[k] / plain[k] - 1.0).abs() < 0.01);
    }
}

#[test]
fn clamp_limits_only_bright_paths() {
    let scene = scene(Material::grey(0.8), env_map());
    let free = render(&scene, &settings(16));
    let loose = render(
        &scene,
        &RenderSettings {
            clamp: Some(1e6),
            ..settings(16)
        },
    );
    assert_eq!(free.image, loose.image);
    let tight = render(
        &scene,
        &RenderSettings {
            clamp: Some(0.5),
            ..settings(16)
        },
    );
    assert!(tight.image.pixels.iter().flatten().all(|v| *v <= 0.5001));
}

#[test]
fn depth_is_along_optical_axis() {
    let scene = scene(Material::grey(0.5), env_map());
    let renderer = Renderer::new(&scene).unwrap();
    let depth = renderer.depth(&scene.camera).unwrap();
    let mut met = 0;
    for row in 0..SIZE {
        for column in 0..SIZE {
            let z = f64::from(depth[row * SIZE + column]);
            let [origin, direction] = scene.camera.ray(column as f64, row as f64);
            let axis = scene.camera.t_world_camera.transform_vector(DVec3::Z);
            let point = origin + direction * (z / direction.dot(axis));
            if z > 0.0 {
                let [c, r, found] = scene.camera.project(point).unwrap();
                assert!((c - column as f64).abs() < 1e-6 && (r - row as f64).abs() < 1e-6);
                assert!((found - z).abs() < 1e-9);
                let on_ball = (point.length() - 0.025).abs() < 5e-4;
                let on_ground = (point.z + 0.026).abs() < 1e-5;
                assert!(on_ball || on_ground, "{point}");
                met += 1;
            }
        }
    }
    assert!(met > SIZE * SIZE / 2);
    let rendering = render(&scene, &settings(1));
    assert_eq!(rendering.depth_m, depth);
}

#[test]
fn albedo_and_normal_are_of_first_surface() {
    let scene = scene(Material::grey(0.25), EnvMap::uniform([0.0; 3]));
    let rendering = render(&scene, &settings(4));
    let middle = SIZE / 2 * SIZE + SIZE / 2;
    assert_eq!(rendering.albedo.pixels[middle], [0.25; 3]);
    let normal = Vec3::from_array(rendering.normal.pixels[middle]);
    let towards = scene
        .camera
        .t_world_camera
        .translation_m
        .as_vec3()
        .normalize();
    assert!(normal.dot(towards) > 0.9, "{normal}");
    assert!(rendering.image.pixels.iter().flatten().all(|v| *v == 0.0));
}

#[test]
fn ground_texture_has_documented_orientation() {
    // Four colours on the ground, seen from straight above.
    let image =
        image::RgbImage::from_raw(2, 2, vec![255, 0, 0, 0, 255, 0, 0, 0, 255, 255, 255, 255]);
    let mut scene = scene(Material::grey(0.5), EnvMap::uniform([1.0; 3]));
    scene.meshes = vec![Mesh::ground(Vec3::ZERO, 0.5, 1.0, 0)];
    scene.materials[0] = Material::Diffuse {
        reflectance: Colour::Texture(0),
    };
    scene.textures = vec![Bitmap::from_srgb8(&image.unwrap()).unwrap()];
    let down = glam::DQuat::from_rotation_x(std::f64::consts::PI);
    scene.camera = Camera::centred(4, 4, 0.9, Pose::new(down, DVec3::Z));
    let rendering = render(&scene, &settings(16));
    let colour = |column: usize, row: usize| {
        let p = rendering.image.at(column, row);
        [p[0] > 0.5, p[1] > 0.5, p[2] > 0.5]
    };
    // Turned about x, the camera sees +x to the right and +y up. The top-left texel lies at
    // positive x and, as v runs down, negative y; the others follow by repetition.
    assert_eq!(colour(3, 3), [true, false, false]);
    assert_eq!(colour(0, 3), [false, true, false]);
    assert_eq!(colour(3, 0), [false, false, true]);
    assert_eq!(colour(0, 0), [true, true, true]);
}

#[test]
fn rendering_reports_progress_and_can_be_cancelled() {
    use std::sync::atomic::AtomicBool;
    let scene = scene(Material::grey(0.5), env_map());
    let renderer = Renderer::new(&scene).unwrap();
    let seen = AtomicUsize::new(0);
    let progress = |done: usize, all: usize| {
        assert!(done <= all && all == 4);
        seen.fetch_max(done, Ordering::Relaxed);
    };
    let control = RenderControl {
        on_progress: Some(&progress),
        cancel: None,
    };
    renderer
        .render(&scene.camera, &settings(1), &control)
        .unwrap();
    assert_eq!(seen.load(Ordering::Relaxed), 4);
    let stop = AtomicBool::new(true);
    let control = RenderControl {
        on_progress: None,
        cancel: Some(&stop),
    };
    let error = renderer.render(&scene.camera, &settings(1), &control);
    assert_eq!(error.unwrap_err().kind(), ErrorKind::Interrupted);
}

#[test]
fn invalid_scene_error_names_the_value() {
    let good = scene(Material::grey(0.5), env_map());
    let explain = |change: &dyn Fn(&mut Scene), words: &[&str]| {
        let mut bad = good.clone();
        change(&mut bad);
        let text = Renderer::new(&bad).unwrap_err().to_string();
        for word in words {
            assert!(text.contains(word), "{word:?} is not in: {text}");
        }
    };
    explain(
        &|s| s.meshes[0].positions[3].y = f32::NAN,
        &["mesh 0", "position 3", "NaN"],
    );
    explain(
        &|s| s.meshes[1].triangles[1][2] = 77,
        &["mesh 1", "triangle 1", "77"],
    );
    explain(
        &|s| s.meshes[1].material = 5,
        &["mesh 1", "material index 5", "2 materials"],
    );
    explain(
        &|s| s.meshes[0].normals.truncate(2),
        &["mesh 0", "normals", "found 2"],
    );
    explain(
        &|s| {
            s.materials[1] = Material::Diffuse {
                reflectance: Colour::Texture(2),
            };
        },
        &["material 1", "texture index 2"],
    );
    explain(
        &|s| {
            s.materials[1] = Material::Principled {
                base_colour: Colour::Constant([0.5, 1.5, 0.0]),
                metallic: 0.0,
                roughness: 0.5,
                ior: 1.5,
            };
        },
        &["material 1", "colour", "1.5"],
    );
    explain(
        &|s| {
            let image = image::RgbImage::new(1, 1);
            s.textures = vec![Bitmap::from_srgb8(&image).unwrap()];
            s.materials[0] = Material::Diffuse {
                reflectance: Colour::Texture(0),
            };
        },
        &["mesh 0", "no texture coordinates"],
    );
    explain(
        &|s| s.env_map.map.pixels[9][1] = f32::INFINITY,
        &["environment map", "column 9"],
    );
    explain(&|s| s.camera.width = 0, &["camera", "0×24"]);
    assert!(Bitmap::from_srgb8(&image::RgbImage::new(0, 0)).is_err());
    let renderer = Renderer::new(&good).unwrap();
    let none = renderer.render(&good.camera, &settings(0), &RenderControl::default());
    assert_eq!(none.unwrap_err().kind(), ErrorKind::Usage);
}
