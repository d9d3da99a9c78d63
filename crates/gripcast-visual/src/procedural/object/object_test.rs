use super::super::tests::closes;
use super::*;
use crate::linear_image::LUMINANCE;
use gripcast_imaging::srgb_decode;

fn appearance(finish: Finish, pattern: Pattern, base_colour: [f32; 3]) -> Appearance {
    Appearance {
        finish,
        base_colour,
        roughness: 0.3,
        pattern,
    }
}

fn all() -> impl Iterator<Item = (Finish, Pattern)> {
    let words = |finish| Pattern::ALL.into_iter().map(move |word| (finish, word));
    Finish::ALL.into_iter().flat_map(words)
}

fn mean_luminance(image: &image::RgbImage) -> f32 {
    let sum: f64 = image
        .pixels()
        .map(|p| {
            let parts = p.0.iter().zip(LUMINANCE);
            parts
                .map(|(v, w)| f64::from(w * srgb_decode(*v)))
                .sum::<f64>()
        })
        .sum();
    (sum / f64::from(image.width() * image.height())) as f32
}

const OAK: [f32; 3] = [0.55, 0.36, 0.15];
const WHITE: [f32; 3] = [0.80, 0.80, 0.77];
const BLACK: [f32; 3] = [0.013, 0.013, 0.0144];
const BLUE: [f32; 3] = [0.018, 0.093, 0.381];
const YELLOW: [f32; 3] = [0.745, 0.479, 0.0137];

#[test]
fn textures_depend_on_seed_and_tile() {
    for (finish, word) in all() {
        let appearance = appearance(finish, word, OAK);
        let object = object_texture(&appearance, 64, 5);
        assert_eq!(object, object_texture(&appearance, 64, 5), "{appearance:?}");
        assert_ne!(
            object.image,
            object_texture(&appearance, 64, 6).image,
            "{appearance:?}"
        );
        assert!(object.tile_m > 0.0 && (0.0..=1.0).contains(&object.roughness));
        closes(&object.image, &format!("{appearance:?}"));
    }
}

#[test]
fn texture_does_not_depend_on_thread_count() {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
    let one = pool.unwrap();
    for (finish, word) in all().step_by(7) {
        let appearance = appearance(finish, word, BLUE);
        let alone = one.install(|| object_texture(&appearance, 48, 9));
        assert_eq!(alone, object_texture(&appearance, 48, 9), "{appearance:?}");
    }
}

#[test]
fn base_colour_is_the_mean() {
    for (finish, word) in all() {
        for (seed, base) in [OAK, WHITE, BLACK, BLUE, YELLOW].into_iter().enumerate() {
            let appearance = appearance(finish, word, base);
            let image = object_texture(&appearance, 64, seed as u64).image;
            let ratio = mean_luminance(&image) / luminance(base);
            if appearance.is_print() || word == Pattern::Rusty {
                assert!(image.pixels().any(|p| p != image.get_pixel(0, 0)));
            } else {
                assert!((0.85..=1.15).contains(&ratio), "{appearance:?}: {ratio}");
            }
        }
    }
}

#[test]
fn patterns_of_one_finish_differ() {
    for finish in Finish::ALL {
        let contrast = |word| {
            let image = object_texture(&appearance(finish, word, BLUE), 64, 3).image;
            let mean = mean_luminance(&image);
            let levels = image.pixels().map(|p| {
                let parts = p.0.iter().zip(LUMINANCE);
                parts.map(|(v, w)| w * srgb_decode(*v)).sum::<f32>() / mean - 1.0
            });
            (levels.map(|v| v * v).sum::<f32>() / (64.0 * 64.0)).sqrt()
        };
        for word in [
            Pattern::Striped,
            Pattern::Dotted,
            Pattern::Scratched,
            Pattern::Rusty,
        ] {
            let (marked, plain) = (contrast(word), contrast(Pattern::Plain));
            let wanted = if finish == Finish::Print { 0.3 } else { plain };
            assert!(marked > wanted, "{finish:?} {word:?}: {marked} {plain}");
        }
    }
}

#[test]
fn black_and_white_are_supported() {
    for (finish, word) in all() {
        let black = object_texture(&appearance(finish, word, [0.0; 3]), 16, 1);
        let white = object_texture(&appearance(finish, word, [1.0; 3]), 16, 1);
        if !appearance(finish, word, [0.0; 3]).is_print() && word != Pattern::Rusty {
            assert!(mean_luminance(&white.image) > 0.8, "{finish:?} {word:?}");
        }
        assert_eq!(black.image.dimensions(), (16, 16));
    }
}

#[test]
fn metal_is_metallic_and_wear_is_rough() {
    for word in Pattern::ALL {
        let metal = object_texture(&appearance(Finish::Metal, word, WHITE), 16, 1);
        assert_eq!(metal.metallic == 1.0, word != Pattern::Rusty, "{word:?}");
        assert_eq!(
            object_texture(&appearance(Finish::Paper, word, WHITE), 16, 1).metallic,
            0.0
        );
    }
    let rusty = Appearance {
        roughness: 0.1,
        ..appearance(Finish::Metal, Pattern::Rusty, WHITE)
    };
    assert!(object_texture(&rusty, 16, 1).roughness > 0.4);
}
