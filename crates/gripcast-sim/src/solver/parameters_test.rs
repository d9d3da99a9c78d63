use super::*;
use gripcast_base::error::ErrorKind;

type Set = fn(&mut SolverParameters, f64);

#[test]
fn invalid_parameters_are_rejected_by_name() {
    let invalid = [f64::NAN, f64::INFINITY, 0.0, -1.0];
    let table: [(&str, Set, &[f64]); 12] = [
        ("dt_s", |p, v| p.dt_s = v, &invalid),
        ("kappa_pa", |p, v| p.kappa_pa = v, &invalid),
        ("d_hat_m", |p, v| p.d_hat_m = v, &invalid),
        ("eps_v_m_s", |p, v| p.eps_v_m_s = v, &invalid),
        (
            "newton_tolerance_m_s",
            |p, v| p.newton_tolerance_m_s = v,
            &invalid,
        ),
        (
            "affine_stiffness_pa",
            |p, v| p.affine_stiffness_pa = v,
            &invalid,
        ),
        (
            "candidate_margin_m",
            |p, v| p.candidate_margin_m = v,
            &invalid,
        ),
        (
            "ccd_slack",
            |p, v| p.ccd_slack = v,
            &[f64::NAN, 0.0, 1.0, 2.0],
        ),
        (
            "gravity_m_s2",
            |p, v| p.gravity_m_s2 = v,
            &[f64::NAN, f64::NEG_INFINITY],
        ),
        ("max_iterations", |p, v| p.max_iterations = v as u32, &[0.0]),
        (
            "max_grasp_iterations",
            |p, v| p.max_grasp_iterations = v as u64,
            &[0.0],
        ),
        ("max_factor_age", |p, v| p.max_factor_age = v as u32, &[0.0]),
    ];
    assert!(SolverParameters::default().validate().is_ok());
    for (name, set, values) in table {
        for &value in values {
            let mut parameters = SolverParameters::default();
            set(&mut parameters, value);
            let error = parameters.validate().unwrap_err();
            assert_eq!(error.kind(), ErrorKind::Config, "{name}");
            assert!(
                error.to_string().contains(name),
                "{name} = {value}: {error}"
            );
        }
    }
}

#[test]
fn zero_and_upward_gravity_are_valid() {
    for gravity_m_s2 in [0.0, 9.81] {
        let parameters = SolverParameters {
            gravity_m_s2,
            ..Default::default()
        };
        assert!(parameters.validate().is_ok());
    }
}
