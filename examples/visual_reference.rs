//! Path tracer on a reference scene: CPU time and error for several sample counts, and export of
//! the scene for another renderer.
//!
//! ```text
//! cargo run --release --example visual_reference -- OUT [--hdr FILE] [--material NAME]
//!     [--samples 4,16,64] [--reference 4096] [--threads N] [--export]
//! ```
//!
//! Prints one JSON object. `OUT` receives the images as PFM (linear light) and PNG, and with
//! `--export` the scene as `scene.json` with PLY meshes, PNG textures and a PFM environment map
//! whose rows begin and end at the poles, which `tests/peers/mitsuba_scene.py` renders.
//! Materials: diffuse, principled, metal, glass.

use std::error::Error;
use std::f64::consts::PI;
use std::fs;
use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3};
use gripcast_visual::{
    Bitmap, Camera, Colour, DENOISE_RADIUS_PX, EnvMap, Image, Material, Mesh, PixelFilter,
    RenderControl, RenderSettings, Renderer, Rendering, Scene, denoise, load_hdr,
};
use image::{Rgb, RgbImage};
use serde_json::json;

type BoxResult<T> = Result<T, Box<dyn Error>>;

struct Options {
    out: PathBuf,
    hdr: Option<PathBuf>,
    material: String,
    samples: Vec<u32>,
    reference: u32,
    export: bool,
}

fn main() -> BoxResult<()> {
    let options = options()?;
    fs::create_dir_all(&options.out)?;
    let scene = scene(&options)?;
    if options.export {
        export(&scene, &options.out)?;
    }
    let started = cpu_seconds();
    let renderer = Renderer::new(&scene)?;
    let prepare_s = cpu_seconds() - started;
    let render = |samples: u32, seed: u64| -> BoxResult<(Rendering, f64)> {
        let settings = RenderSettings {
            samples_per_pixel: samples,
            max_bounces: 5,
            rr_depth: 4,
            filter: PixelFilter::Box,
            seed,
            ..RenderSettings::default()
        };
        let started = cpu_seconds();
        let rendering = renderer.render(&scene.camera, &settings, &RenderControl::default())?;
        Ok((rendering, cpu_seconds() - started))
    };
    let mut figures = Vec::new();
    let reference = match options.reference {
        0 => None,
        samples => {
            let (Rendering { image, .. }, cpu_s) = render(samples, 1)?;
            save(&image, &options.out.join("reference"))?;
            figures.push(json!({"samples": samples, "cpu_s": cpu_s, "mean": image.mean()}));
            Some(image)
        }
    };
    for &samples in &options.samples {
        let (rendering, cpu_s) = render(samples, 2)?;
        let started = cpu_seconds();
        let smooth = denoise(&rendering, DENOISE_RADIUS_PX);
        let denoise_cpu_s = cpu_seconds() - started;
        let image = rendering.image;
        save(&image, &options.out.join(format!("samples{samples}")))?;
        save(
            &smooth,
            &options.out.join(format!("samples{samples}denoised")),
        )?;
        let error = |image: &Image| reference.as_ref().map(|r| image.rmse(r)).transpose();
        figures.push(json!({
            "samples": samples, "cpu_s": cpu_s, "rmse": error(&image)?, "mean": image.mean(),
            "denoise_cpu_s": denoise_cpu_s, "denoised_rmse": error(&smooth)?,
        }));
    }
    let triangles: usize = scene.meshes.iter().map(|m| m.triangles.len()).sum();
    let report = json!({
        "name": "visual", "material": options.material, "triangles": triangles,
        "prepare_s": prepare_s, "figures": figures,
    });
    println!("{report:#}");
    Ok(())
}

fn options() -> BoxResult<Options> {
    let mut options = Options {
        out: PathBuf::new(),
        hdr: None,
        material: "diffuse".into(),
        samples: vec![4, 16, 64],
        reference: 4096,
        export: false,
    };
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().ok_or(format!("{argument} needs a value"));
        match argument.as_str() {
            "--hdr" => options.hdr = Some(value()?.into()),
            "--material" => options.material = value()?,
            "--samples" => {
                options.samples = value()?
                    .split(',')
                    .map(str::parse)
                    .collect::<Result<_, _>>()?;
            }
            "--reference" => options.reference = value()?.parse()?,
            "--threads" => rayon::ThreadPoolBuilder::new()
                .num_threads(value()?.parse()?)
                .build_global()?,
            "--export" => options.export = true,
            _ => options.out = argument.into(),
        }
    }
    if options.out.as_os_str().is_empty() {
        return Err("missing output folder".into());
    }
    Ok(options)
}

/// CPU time of all threads of this process, s.
fn cpu_seconds() -> f64 {
    let stat = fs::read_to_string("/proc/self/schedstat").unwrap_or_default();
    let own = |text: &str| text.split(' ').next().and_then(|t| t.parse::<f64>().ok());
    let tasks = fs::read_dir("/proc/self/task")
        .into_iter()
        .flatten()
        .flatten();
    let all = tasks.filter_map(|t| own(&fs::read_to_string(t.path().join("schedstat")).ok()?));
    all.sum::<f64>().max(own(&stat).unwrap_or(0.0)) * 1e-9
}

fn scene(options: &Options) -> BoxResult<Scene> {
    let material = match options.material.as_str() {
        "diffuse" => Material::Diffuse {
            reflectance: Colour::Texture(0),
        },
        "principled" => Material::Principled {
            base_colour: Colour::Texture(0),
            metallic: 0.0,
            roughness: 0.5,
            ior: 1.5,
        },
        "metal" => Material::Conductor {
            eta: [0.2, 0.92, 1.1],
            k: [3.9, 2.45, 2.1],
            roughness: 0.3,
        },
        "glass" => Material::Dielectric {
            ior: 1.5,
            roughness: 0.0,
            transmittance: [1.0; 3],
        },
        other => return Err(format!("unknown material `{other}`").into()),
    };
    let env_map = match &options.hdr {
        Some(path) => EnvMap::new(load_hdr(path)?),
        None => EnvMap::new(sky(1024, 512)),
    };
    let eye = DVec3::new(0.26, -0.16, 0.2);
    let pose = Camera::look_at(eye, DVec3::new(0.0, 0.0, 0.05)).ok_or("no view")?;
    Ok(Scene {
        meshes: vec![blob(282, 142, 0), Mesh::ground(Vec3::ZERO, 0.5, 0.25, 1)],
        materials: vec![
            material,
            Material::Diffuse {
                reflectance: Colour::Texture(1),
            },
        ],
        textures: vec![
            Bitmap::from_srgb8(&stripes(512, [200, 90, 40], [230, 220, 190]))?,
            Bitmap::from_srgb8(&stripes(512, [110, 80, 50], [170, 140, 100]))?,
        ],
        env_map,
        camera: Camera::centred(320, 240, 0.75, pose),
    })
}

/// Bumpy ball of about 60 mm radius on the ground with smooth normals.
fn blob(columns: usize, rows: usize, material: usize) -> Mesh {
    let position = |u: f64, v: f64| {
        let (azimuth, polar) = (2.0 * PI * u, PI * v);
        let bump = (6.0 * azimuth).sin() * (5.0 * polar).sin() * polar.sin();
        let radius = 0.055 * (1.0 + 0.12 * bump);
        DVec3::new(
            radius * polar.sin() * azimuth.cos(),
            radius * polar.sin() * azimuth.sin(),
            radius * polar.cos() + 0.062,
        )
    };
    let mut mesh = Mesh {
        material,
        ..Mesh::default()
    };
    for row in 0..=rows {
        for column in 0..=columns {
            let (u, v) = (column as f64 / columns as f64, row as f64 / rows as f64);
            let h = 1e-5;
            let across = position(u + h, v) - position(u - h, v);
            let down = position(u, v + h) - position(u, v - h);
            let pole = if row == 0 { DVec3::Z } else { DVec3::NEG_Z };
            let normal = match row {
                0 => pole,
                r if r == rows => pole,
                _ => down.cross(across).normalize(),
            };
            mesh.positions.push(position(u, v).as_vec3());
            mesh.normals.push(normal.as_vec3());
            mesh.uvs.push([2.0 * u as f32, v as f32]);
        }
    }
    let index = |row: usize, column: usize| (row * (columns + 1) + column) as u32;
    for row in 0..rows {
        for column in 0..columns {
            let [a, b] = [index(row, column), index(row, column + 1)];
            let [c, d] = [index(row + 1, column), index(row + 1, column + 1)];
            if row > 0 {
                mesh.triangles.push([a, c, b]);
            }
            if row + 1 < rows {
                mesh.triangles.push([b, c, d]);
            }
        }
    }
    mesh
}

/// Irregular stripes between two colours.
fn stripes(size: u32, dark: [u8; 3], light: [u8; 3]) -> RgbImage {
    RgbImage::from_fn(size, size, |x, y| {
        let [u, v] = [x, y].map(|c| 2.0 * PI * f64::from(c) / f64::from(size));
        let wave = (8.0 * u + 2.0 * (3.0 * v).sin()).sin() * 0.5 + 0.5;
        let grain = f64::from((x * 7919 + y * 104_729) % 64) / 64.0;
        let t = 0.85 * wave + 0.15 * grain;
        let mix = |k: usize| f64::from(dark[k]) * (1.0 - t) + f64::from(light[k]) * t;
        Rgb([0, 1, 2].map(|k| mix(k).round() as u8))
    })
}

/// Soft sky with two bright spots.
fn sky(width: usize, height: usize) -> Image {
    let spots = [
        (
            DVec3::new(0.3, -0.6, 0.6).normalize(),
            60.0,
            [1.0, 0.9, 0.7],
        ),
        (DVec3::new(0.5, 0.8, 0.4).normalize(), 25.0, [0.6, 0.8, 1.0]),
    ];
    let mut image = Image::filled(width, height, [0.0; 3]);
    for row in 0..height {
        for column in 0..width {
            let azimuth = 2.0 * PI * (0.5 - (column as f64 + 0.5) / width as f64);
            let polar = PI * (row as f64 + 0.5) / height as f64;
            let d = DVec3::new(
                polar.sin() * azimuth.cos(),
                polar.sin() * azimuth.sin(),
                polar.cos(),
            );
            let base = 0.3 + 0.4 * d.z.max(0.0);
            let mut rgb = [0.8 * base, 0.9 * base, base];
            for (towards, strength, colour) in spots {
                let falloff = (400.0 * (d.dot(towards) - 1.0)).exp();
                for k in 0..3 {
                    rgb[k] += strength * colour[k] * falloff;
                }
            }
            image.pixels[row * width + column] = rgb.map(|v| v as f32);
        }
    }
    image
}

fn save(image: &Image, path: &Path) -> BoxResult<()> {
    write_pfm(image, &path.with_extension("pfm"))?;
    image.to_srgb8(0.8).save(path.with_extension("png"))?;
    Ok(())
}

/// Portable float map: rows from the bottom, little-endian.
fn write_pfm(image: &Image, path: &Path) -> BoxResult<()> {
    let mut bytes = format!("PF\n{} {}\n-1.0\n", image.width, image.height).into_bytes();
    for row in image.pixels.chunks(image.width).rev() {
        bytes.extend(row.iter().flatten().flat_map(|v| v.to_le_bytes()));
    }
    Ok(fs::write(path, bytes)?)
}

fn export(scene: &Scene, out: &Path) -> BoxResult<()> {
    let mut meshes = Vec::new();
    for (m, mesh) in scene.meshes.iter().enumerate() {
        let file = format!("mesh{m}.ply");
        fs::write(out.join(&file), ply(mesh))?;
        meshes.push(json!({"file": file, "material": mesh.material}));
    }
    for (t, texture) in scene.textures.iter().enumerate() {
        let file = out.join(format!("texture{t}.png"));
        texture.to_srgb8().save(file)?;
    }
    write_pfm(
        &with_poles(&scene.env_map.map),
        &out.join("environment.pfm"),
    )?;
    let materials: Vec<_> = scene.materials.iter().map(material_json).collect();
    let camera = &scene.camera;
    let axes = camera.t_world_camera.rotation_matrix();
    let report = json!({
        "meshes": meshes,
        "materials": materials,
        "environment": {
            "file": "environment.pfm",
            "rotation_rad": scene.env_map.rotation_rad,
            "intensity": scene.env_map.intensity,
        },
        "camera": {
            "width": camera.width, "height": camera.height,
            "focal_px": camera.focal_px, "principal_px": camera.principal_px,
            "eye_m": camera.t_world_camera.translation_m.to_array(),
            "right": axes.x_axis.to_array(), "down": axes.y_axis.to_array(),
            "forward": axes.z_axis.to_array(),
        },
        "max_bounces": 5,
    });
    Ok(fs::write(out.join("scene.json"), format!("{report:#}\n"))?)
}

fn material_json(material: &Material) -> serde_json::Value {
    let colour = |c: Colour| match c {
        Colour::Constant(rgb) => json!(rgb),
        Colour::Texture(t) => json!(format!("texture{t}.png")),
    };
    match *material {
        Material::Diffuse { reflectance } => {
            json!({"kind": "diffuse", "colour": colour(reflectance)})
        }
        Material::Principled {
            base_colour,
            metallic,
            roughness,
            ior,
        } => json!({
            "kind": "principled", "colour": colour(base_colour), "metallic": metallic,
            "roughness": roughness, "ior": ior,
        }),
        Material::Conductor { eta, k, roughness } => {
            json!({"kind": "conductor", "eta": eta, "k": k, "roughness": roughness})
        }
        Material::Dielectric { ior, roughness, .. } => {
            json!({"kind": "dielectric", "ior": ior, "roughness": roughness})
        }
    }
}

/// Resamples an environment map to rows that start and end at the poles, where other renderers
/// interpolate.
fn with_poles(map: &Image) -> Image {
    let row = |r: usize, column: usize| map.at(column, r.min(map.height - 1));
    let mut out = Image::filled(map.width, 2 * map.height + 1, [0.0; 3]);
    for r in 0..out.height {
        for column in 0..map.width {
            let above = row((r.max(1) - 1) / 2, column);
            let below = row(r / 2, column);
            let mean = [0, 1, 2].map(|k| 0.5 * (above[k] + below[k]));
            out.pixels[r * map.width + column] = mean;
        }
    }
    out
}

fn ply(mesh: &Mesh) -> Vec<u8> {
    let mut header = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\n",
        mesh.positions.len()
    );
    let mut names = vec!["x", "y", "z"];
    if !mesh.normals.is_empty() {
        names.extend(["nx", "ny", "nz"]);
    }
    if !mesh.uvs.is_empty() {
        names.extend(["u", "v"]);
    }
    for name in names {
        header += &format!("property float {name}\n");
    }
    header += &format!(
        "element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        mesh.triangles.len()
    );
    let mut bytes = header.into_bytes();
    for v in 0..mesh.positions.len() {
        let mut values = mesh.positions[v].to_array().to_vec();
        values.extend(mesh.normals.get(v).into_iter().flat_map(|n| n.to_array()));
        values.extend(mesh.uvs.get(v).into_iter().flatten());
        bytes.extend(values.iter().flat_map(|v| v.to_le_bytes()));
    }
    for triangle in &mesh.triangles {
        bytes.push(3);
        bytes.extend(triangle.iter().flat_map(|v| v.to_le_bytes()));
    }
    bytes
}
