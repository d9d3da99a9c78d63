use std::f32::consts::PI;

use super::super::sampler::SobolSampler;
use super::*;

fn white(roughness: f32, metallic: f32) -> Material {
    Material::Principled {
        base_colour: Colour::Constant([1.0; 3]),
        metallic,
        roughness,
        ior: 1.5,
    }
}

/// A perfect reflector: index of refraction 0 + i·1 has reflectance 1 at all angles.
fn perfect_metal(roughness: f32) -> Material {
    Material::Conductor {
        eta: [0.0; 3],
        k: [1.0; 3],
        roughness,
    }
}

fn glass(roughness: f32) -> Material {
    Material::Dielectric {
        ior: 1.5,
        roughness,
        transmittance: [1.0; 3],
    }
}

fn direction(cos: f32, azimuth: f32) -> Vec3 {
    let sin = (1.0 - cos * cos).sqrt();
    Vec3::new(sin * azimuth.cos(), sin * azimuth.sin(), cos)
}

fn prepared(material: &Material) -> PreparedMaterial {
    PreparedMaterial::new(material)
}

fn at(material: &PreparedMaterial, outgoing: Vec3) -> Bsdf<'_> {
    material.at(&[], [0.0; 2], outgoing)
}

/// Directional albedo estimated by sampling.
fn sampled_albedo(material: &PreparedMaterial, outgoing: Vec3) -> Vec3 {
    let net = SobolSampler::new(4096, 3);
    let bsdf = at(material, outgoing);
    let mut sum = Vec3::ZERO;
    for index in 0..4096 {
        let numbers = net.sample(0, index);
        let choice = numbers.get_2d(0)[0];
        if let Some(sample) = bsdf.sample(outgoing, choice, numbers.get_2d(1)) {
            sum += sample.weight;
        }
    }
    sum / 4096.0
}

/// Integrals of value and density over all directions.
fn integrals(bsdf: &Bsdf<'_>, outgoing: Vec3, below: bool) -> (Vec3, f32) {
    let (steps, azimuths) = (300, 120);
    let (mut value, mut pdf) = (glam::DVec3::ZERO, 0.0f64);
    for i in 0..steps {
        let cos = (i as f32 + 0.5) / steps as f32;
        for j in 0..azimuths {
            let azimuth = 2.0 * PI * (j as f32 + 0.5) / azimuths as f32;
            for side in if below { &[1.0, -1.0][..] } else { &[1.0] } {
                let mut incoming = direction(cos, azimuth);
                incoming.z *= side;
                let found = bsdf.value(outgoing, incoming);
                value += found.value.as_dvec3();
                pdf += f64::from(found.pdf);
            }
        }
    }
    let cell = 2.0 * std::f64::consts::PI / f64::from(steps * azimuths);
    ((value * cell).as_vec3(), (pdf * cell) as f32)
}

#[test]
fn white_materials_conserve_energy() {
    for roughness in [0.0, 0.1, 0.3, 0.5, 0.8, 1.0] {
        let cases = [
            Material::grey(1.0),
            white(roughness, 0.0),
            white(roughness, 1.0),
            white(roughness, 0.5),
            perfect_metal(roughness),
            glass(roughness),
        ];
        for case in &cases {
            let material = prepared(case);
            for cos in [0.1, 0.3, 0.7, 1.0] {
                let found = sampled_albedo(&material, direction(cos, 0.4));
                assert!(
                    (found.x - 1.0).abs() < 0.012,
                    "{case:?} at cos {cos}: {found}"
                );
            }
        }
    }
}

#[test]
fn frosted_glass_conserves_energy_from_inside() {
    for roughness in [0.0, 0.3, 0.6] {
        let material = prepared(&glass(roughness));
        for cos in [0.2, 0.6, 0.95] {
            let found = sampled_albedo(&material, -direction(cos, 0.4));
            assert!((found.x - 1.0).abs() < 0.012, "{roughness} {cos}: {found}");
        }
    }
}

#[test]
fn no_material_gains_energy() {
    let gold = |roughness| Material::Conductor {
        eta: [0.14, 0.37, 1.44],
        k: [3.98, 2.38, 1.6],
        roughness,
    };
    let red = |roughness, metallic| Material::Principled {
        base_colour: Colour::Constant([0.9, 0.3, 0.0]),
        metallic,
        roughness,
        ior: 1.8,
    };
    for roughness in [0.05, 0.2, 0.6, 1.0] {
        for case in [gold(roughness), red(roughness, 0.0), red(roughness, 1.0)] {
            let material = prepared(&case);
            for cos in [0.05, 0.4, 0.9] {
                let found = sampled_albedo(&material, direction(cos, 2.0));
                assert!(found.max_element() < 1.01, "{case:?} {cos}: {found}");
                assert!(found.min_element() > 0.0, "{case:?} {cos}: {found}");
            }
        }
    }
}

#[test]
fn pdf_integrates_to_fraction_of_valid_samples() {
    for case in [
        Material::grey(0.5),
        white(0.4, 0.0),
        white(0.7, 0.6),
        perfect_metal(0.5),
        glass(0.5),
    ] {
        let material = prepared(&case);
        let through = matches!(case, Material::Dielectric { .. });
        for cos in [0.3, 0.9] {
            let outgoing = direction(cos, 0.3);
            let bsdf = at(&material, outgoing);
            let (value, pdf) = integrals(&bsdf, outgoing, through);
            let net = SobolSampler::new(4096, 8);
            let kept = (0..4096).filter(|&index| {
                let numbers = net.sample(0, index);
                bsdf.sample(outgoing, numbers.get_2d(0)[0], numbers.get_2d(1))
                    .is_some()
            });
            let kept = kept.count() as f32 / 4096.0;
            assert!((pdf - kept).abs() < 0.01, "{case:?} {cos}: {pdf} {kept}");
            let sampled = sampled_albedo(&material, outgoing);
            assert!(
                (value - sampled).abs().max_element() < 0.01,
                "{case:?} {cos}: {value} {sampled}"
            );
        }
    }
}

#[test]
fn samples_agree_with_value_and_pdf() {
    let net = SobolSampler::new(256, 1);
    for case in [
        Material::grey(0.5),
        white(0.3, 0.3),
        perfect_metal(0.4),
        glass(0.4),
    ] {
        let material = prepared(&case);
        for outgoing in [direction(0.8, 1.0), direction(0.2, -1.0)] {
            let bsdf = at(&material, outgoing);
            for index in 0..256 {
                let numbers = net.sample(7, index);
                let Some(sample) = bsdf.sample(outgoing, numbers.get_2d(0)[0], numbers.get_2d(1))
                else {
                    continue;
                };
                let found = bsdf.value(outgoing, sample.direction);
                let expected = sample.weight * sample.pdf;
                let scale = expected.max_element().max(1e-3);
                assert!((sample.direction.length() - 1.0).abs() < 1e-3);
                // Half vectors of near-grazing refraction lose digits.
                assert!(
                    (found.pdf - sample.pdf).abs() < 0.03 * sample.pdf + 1e-3,
                    "{case:?}: {} {}",
                    found.pdf,
                    sample.pdf
                );
                assert!(
                    (found.value - expected).abs().max_element() < 0.03 * scale + 1e-3,
                    "{case:?}"
                );
            }
        }
    }
}

#[test]
fn reflection_is_reciprocal() {
    for case in [
        Material::grey(0.5),
        white(0.4, 0.0),
        white(0.6, 0.5),
        perfect_metal(0.5),
        Material::Conductor {
            eta: [0.2, 1.0, 2.0],
            k: [3.0, 2.0, 1.0],
            roughness: 0.3,
        },
    ] {
        let material = prepared(&case);
        for (a, b) in [(0.9, 0.3), (0.15, 0.6), (0.5, 0.5)] {
            let (a, b) = (direction(a, 0.2), direction(b, 2.4));
            let there = at(&material, a).value(a, b).value / b.z;
            let back = at(&material, b).value(b, a).value / a.z;
            let off = (there - back).abs().max_element();
            assert!(off < 1e-4 * there.max_element(), "{case:?}: {there} {back}");
        }
    }
}

#[test]
fn clear_glass_obeys_snells_law() {
    let material = prepared(&glass(0.0));
    let outgoing = direction(0.6, 0.0);
    let sample = at(&material, outgoing)
        .sample(outgoing, 0.99, [0.5; 2])
        .unwrap();
    assert!(sample.delta && sample.direction.z < 0.0);
    let sines = [outgoing, sample.direction].map(|d| (d.x * d.x + d.y * d.y).sqrt());
    assert!((sines[0] / sines[1] - 1.5).abs() < 1e-5);
    // The reverse direction.
    let back = at(&material, sample.direction)
        .sample(sample.direction, 0.99, [0.5; 2])
        .unwrap();
    assert!((back.direction - outgoing).length() < 1e-5);
}
