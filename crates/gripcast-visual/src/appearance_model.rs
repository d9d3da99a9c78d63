//! Models of a shape with an [`Appearance`] or with a texture image.

use super::appearance::{Appearance, FinishClass};
use super::material::{Colour, IOR, Material};
use super::model::{Model, is_closed};
use super::procedural::object_texture;
use super::shading::{Projection, shaded_mesh};
use super::texture::Bitmap;
use gripcast_base::error::{Error, Result};
use gripcast_geometry::{CREASE_RAD, TriangleMesh};

/// Side of the generated textures, px.
const TEXTURE_PX: u32 = 256;
/// Minimum roughness of worn glass.
const WORN_GLASS: f32 = 0.12;
/// Roughness of a surface with a user's texture: satin paint.
const IMAGE_ROUGHNESS: f32 = 0.5;

impl Model {
    /// Builds a model of a shape (m) with a generated texture; `seed` places grain, dots and wear.
    /// The texture is box-projected: a print covers the object once, other patterns keep their real
    /// size.
    ///
    /// Glass has a tint and roughness but no pattern. A mesh that is not closed cannot be glass and
    /// is rendered as glossy plastic.
    ///
    /// # Errors
    /// `Input` if [`Appearance::validate`] fails.
    ///
    /// ```
    /// use gripcast_geometry::builtin;
    /// use gripcast_visual::{FinishClass, Appearance, Model, SurfacePattern};
    ///
    /// let appearance = Appearance {
    ///     finish: FinishClass::Wood,
    ///     base_colour: [0.55, 0.36, 0.16],
    ///     roughness: 0.4,
    ///     pattern: SurfacePattern::Grain,
    /// };
    /// let oak_mug = Model::with_appearance(&builtin("mug")?, &appearance, 7)?;
    /// assert_eq!(oak_mug.textures.len(), 1);
    /// # Ok::<(), gripcast_base::error::Error>(())
    /// ```
    pub fn with_appearance(
        mesh: &TriangleMesh,
        appearance: &Appearance,
        seed: u64,
    ) -> Result<Self> {
        appearance.validate()?;
        if appearance.finish == FinishClass::Glass && is_closed(mesh) {
            return Ok(Self {
                meshes: vec![shaded_mesh(mesh, CREASE_RAD, Projection::None, 0)],
                materials: vec![glass(appearance)],
                textures: Vec::new(),
            });
        }
        let texture = object_texture(appearance, TEXTURE_PX, seed);
        let bounds = mesh.bounds();
        let extent = bounds.extent().max_element();
        let projection = Projection::Box {
            width_m: if appearance.is_print() && extent > 0.0 {
                extent
            } else {
                texture.tile_m
            },
            origin_m: bounds.min,
        };
        Ok(Self {
            meshes: vec![shaded_mesh(mesh, CREASE_RAD, projection, 0)],
            materials: vec![Material::glossy(
                Colour::Texture(0),
                texture.metallic,
                texture.roughness,
            )],
            textures: vec![Bitmap::from_srgb8(&texture.image)?],
        })
    }

    /// Builds a model of a shape (m) with an image as its base colour, `width_m` wide on the
    /// surface, tiled and box-projected, upright on the vertical sides.
    /// [`load_bitmap`](super::load_bitmap) reads image files.
    ///
    /// # Errors
    /// `Input` if the width is not positive.
    pub fn textured(mesh: &TriangleMesh, image: &Bitmap, width_m: f64) -> Result<Self> {
        if !width_m.is_finite() || width_m <= 0.0 {
            return Err(Error::input(format!(
                "the width of a texture must be positive, found {width_m} m"
            ))
            .remedy("give the width of the image on the object in metres"));
        }
        let projection = Projection::Box {
            width_m,
            origin_m: mesh.bounds().min,
        };
        let mut shaded = shaded_mesh(mesh, CREASE_RAD, projection, 0);
        let [width, height] = image.size();
        let aspect = width as f32 / height as f32;
        for uv in &mut shaded.uvs {
            uv[1] *= aspect;
        }
        Ok(Self {
            meshes: vec![shaded],
            materials: vec![Material::glossy(Colour::Texture(0), 0.0, IMAGE_ROUGHNESS)],
            textures: vec![image.clone()],
        })
    }
}

/// The base colour is the transmittance of the whole body, so each of its two interfaces transmits
/// the square root of it.
fn glass(appearance: &Appearance) -> Material {
    let roughness = if appearance.is_worn() {
        appearance.roughness.max(WORN_GLASS)
    } else {
        appearance.roughness
    };
    Material::Dielectric {
        ior: IOR,
        roughness,
        transmittance: appearance.base_colour.map(f32::sqrt),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Camera, EnvMap, Scene, SurfacePattern};
    use gripcast_geometry::{Pose, builtin};

    fn appearance(finish: FinishClass, pattern: SurfacePattern) -> Appearance {
        Appearance {
            finish,
            base_colour: [0.5, 0.3, 0.1],
            roughness: 0.3,
            pattern,
        }
    }

    fn validate(model: &Model) {
        let mut scene = Scene::empty(
            EnvMap::uniform([1.0; 3]),
            Camera::centred(8, 8, 1.0, Pose::IDENTITY),
        );
        model.add_to(&mut scene, &Pose::IDENTITY);
        scene.validate().unwrap();
    }

    #[test]
    fn every_appearance_gives_a_valid_model() {
        let mesh = builtin("sphere").unwrap();
        for finish in FinishClass::ALL {
            for pattern in SurfacePattern::ALL {
                let model = Model::with_appearance(&mesh, &appearance(finish, pattern), 1).unwrap();
                validate(&model);
                let is_glass = finish == FinishClass::Glass;
                assert_eq!(model.textures.is_empty(), is_glass, "{finish:?}");
                if let Material::Principled { metallic, .. } = model.materials[0] {
                    assert_eq!(metallic > 0.0, finish == FinishClass::Metal, "{finish:?}");
                }
            }
        }
    }

    #[test]
    fn scratched_glass_is_rougher_and_keeps_its_tint() {
        let mesh = builtin("box").unwrap();
        let of = |mesh: &TriangleMesh, pattern| {
            let appearance = Appearance {
                roughness: 0.0,
                ..appearance(FinishClass::Glass, pattern)
            };
            Model::with_appearance(mesh, &appearance, 1)
                .unwrap()
                .materials[0]
        };
        let Material::Dielectric {
            roughness,
            transmittance,
            ..
        } = of(&mesh, SurfacePattern::Plain)
        else {
            panic!("no glass");
        };
        assert_eq!(roughness, 0.0);
        assert!((transmittance[0].powi(2) - 0.5).abs() < 1e-6);
        let scratched = of(&mesh, SurfacePattern::Scratched);
        assert!(matches!(scratched, Material::Dielectric { roughness, .. } if roughness > 0.05));
        let mut open = mesh;
        open.triangles.pop();
        assert!(matches!(
            of(&open, SurfacePattern::Plain),
            Material::Principled { .. }
        ));
    }

    #[test]
    fn invalid_appearance_or_width_is_refused() {
        let mesh = builtin("box").unwrap();
        let mut bad = appearance(FinishClass::Plastic, SurfacePattern::Plain);
        bad.base_colour[1] = f32::NAN;
        let text = Model::with_appearance(&mesh, &bad, 1)
            .unwrap_err()
            .to_string();
        assert!(
            text.contains("appearance") && text.contains("base_colour"),
            "{text}"
        );
        bad = appearance(FinishClass::Plastic, SurfacePattern::Plain);
        bad.roughness = 1.5;
        assert!(Model::with_appearance(&mesh, &bad, 1).is_err());
        let image = Bitmap::from_srgb8(&image::RgbImage::new(4, 2)).unwrap();
        for width in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let text = Model::textured(&mesh, &image, width).unwrap_err();
            assert!(text.to_string().contains("width"), "{text}");
        }
    }

    #[test]
    fn texture_keeps_its_aspect_ratio() {
        let mesh = builtin("box").unwrap();
        let image = Bitmap::from_srgb8(&image::RgbImage::new(40, 20)).unwrap();
        let model = Model::textured(&mesh, &image, 0.06).unwrap();
        validate(&model);
        // The box is 60 mm high: two images of 30 mm on its upright sides.
        let shaded = &model.meshes[0];
        let sides = shaded.uvs.iter().zip(&shaded.normals);
        let rows = sides.filter(|(_, n)| n.z.abs() < 0.1).map(|(uv, _)| uv[1]);
        let (low, high) = rows.fold((f32::MAX, f32::MIN), |(a, b), v| (a.min(v), b.max(v)));
        assert!((high - low - 2.0).abs() < 1e-4, "{low} {high}");
    }
}
