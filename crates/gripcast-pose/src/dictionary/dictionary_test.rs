use super::*;
use gripcast_base::error::ErrorKind;

#[test]
fn codes_match_published_tables() {
    let first = |name: &str, count: u32| -> Vec<u64> {
        let dictionary = Dictionary::by_name(name).unwrap();
        let code = |id| dictionary.rotation_grouped_code(id).unwrap();
        (0..count).map(code).collect()
    };
    assert_eq!(first("DICT_4X4_50", 3), [0xbe50, 0x174e, 0x2db8]);
    assert_eq!(
        first("DICT_5X5_250", 3),
        [0x152_c6e3, 0x15_8da8, 0x1b9_77e8]
    );
    assert_eq!(first("DICT_6X6_250", 2), [0x1_8735_9537, 0xbebe_30f0]);
    // First entries of AprilTag's own tables.
    assert_eq!(first("36h11", 1), [0xd_7e00_984b]);
    assert_eq!(first("16h5", 3), [0x27c8, 0x31b6, 0x3859]);
    assert_eq!(first("25h9", 3), [0x156_f1f4, 0x1f2_8cd5, 0x16c_e32c]);
    let original = Dictionary::by_name("DICT_ARUCO_ORIGINAL").unwrap();
    assert_eq!(original.code(1), Some(0x108_4217));
}

#[test]
fn min_distance_matches_published_values() {
    for (name, side, count, distance) in [
        ("DICT_4X4_50", 4, 50, 4),
        ("DICT_4X4_100", 4, 100, 3),
        ("DICT_4X4_250", 4, 250, 3),
        ("DICT_4X4_1000", 4, 1000, 2),
        ("DICT_5X5_1000", 5, 1000, 5),
        ("DICT_5X5_50", 5, 50, 8),
        ("DICT_5X5_100", 5, 100, 7),
        ("DICT_5X5_250", 5, 250, 6),
        ("DICT_6X6_50", 6, 50, 13),
        ("DICT_6X6_100", 6, 100, 12),
        ("DICT_6X6_250", 6, 250, 11),
        ("DICT_6X6_1000", 6, 1000, 9),
        ("DICT_7X7_50", 7, 50, 19),
        ("DICT_7X7_100", 7, 100, 18),
        ("DICT_7X7_250", 7, 250, 17),
        ("DICT_7X7_1000", 7, 1000, 14),
        ("DICT_ARUCO_MIP_36h12", 6, 250, 12),
        ("DICT_APRILTAG_16h5", 4, 30, 5),
        ("25h9_border2", 5, 35, 9),
        ("DICT_APRILTAG_36h10", 6, 2320, 10),
        ("DICT_APRILTAG_36h11", 6, 587, 11),
        ("36h11", 6, 587, 11),
        ("DICT_ARUCO_ORIGINAL", 5, 1024, 0),
    ] {
        let dictionary = Dictionary::by_name(name).unwrap();
        assert_eq!(dictionary.name(), name);
        assert_eq!(dictionary.bits_per_side(), side, "{name}");
        assert_eq!(dictionary.len(), count, "{name}");
        assert_eq!(dictionary.min_distance(), distance, "{name}");
        assert!(dictionary.marker(count as u32).is_none());
    }
}

#[test]
fn rotation_by_90_degrees_rotates_bit_groups() {
    for name in ["DICT_4X4_50", "DICT_5X5_50", "DICT_6X6_50"] {
        let dictionary = Dictionary::by_name(name).unwrap();
        let side = dictionary.bits_per_side();
        let code = dictionary.code(7).unwrap();
        let quarter = rotated(code, side);
        let rotated_dictionary = Dictionary::from_codes("t", side, 1, vec![quarter]).unwrap();
        let middle = side % 2;
        let group = side * side / 4;
        let plain = dictionary.rotation_grouped_code(7).unwrap() >> middle;
        let mask = (1u64 << (4 * group)) - 1;
        // Clockwise: what was in the last group comes first.
        let rotated = (plain >> group | plain << (3 * group)) & mask;
        assert_eq!(
            rotated_dictionary.rotation_grouped_code(0).unwrap() >> middle,
            rotated
        );
    }
}

#[test]
fn opencv_36h11_is_rotated_by_180_degrees() {
    let april = Dictionary::by_name("36h11").unwrap();
    let opencv = Dictionary::by_name("DICT_APRILTAG_36h11").unwrap();
    for id in [0, 17, 586] {
        let (a, o) = (april.marker(id).unwrap(), opencv.marker(id).unwrap());
        for row in 0..6 {
            for column in 0..6 {
                assert_eq!(a.is_white(row, column), o.is_white(5 - row, 5 - column));
            }
        }
    }
    // The first row that OpenCV draws of id 0: 0x21a146bab.
    assert_eq!(opencv.code(0), Some(0x2_1a14_6bab));
    let kalibr = Dictionary::by_name("36h11_border2").unwrap();
    assert_eq!(
        (kalibr.cells_per_side(), kalibr.code(5)),
        (10, april.code(5))
    );
}

#[test]
fn every_name_has_a_dictionary_of_different_codes() {
    for name in DICTIONARY_NAMES {
        assert_eq!(Dictionary::by_name(name).unwrap().name(), *name);
    }
}

#[test]
fn names_match_without_prefix_and_typos_get_suggestion() {
    for (name, expected) in [
        ("4x4_50", "DICT_4X4_50"),
        ("dict_6x6_250", "DICT_6X6_250"),
        ("tag36h11", "36h11"),
        ("t16h5", "16h5"),
        ("t36h11_border2", "36h11_border2"),
        ("apriltag_36H11", "DICT_APRILTAG_36h11"),
    ] {
        assert_eq!(Dictionary::by_name(name).unwrap().name(), expected);
    }
    let text = Dictionary::by_name("DICT_6X6_25").unwrap_err().to_string();
    assert!(text.contains("did you mean DICT_6X6_250?"), "{text}");
}

const TWO: &str = "%YAML:1.0\n---\nnmarkers: 2\nmarkersize: 3\nmaxCorrectionBits: 0\n\
                   marker_0: \"101011001\"\nmarker_1: 001010111\n";

#[test]
fn opencv_files_accept_quoted_and_bare_codes() {
    let dictionary = Dictionary::from_opencv("own.yml", TWO).unwrap();
    assert_eq!((dictionary.len(), dictionary.bits_per_side()), (2, 3));
    let marker = dictionary.marker(1).unwrap();
    assert!(!marker.is_white(0, 0) && marker.is_white(0, 2) && marker.is_white(2, 2));
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("own.yml"), TWO).unwrap();
    assert_eq!(
        Dictionary::open("own.yml", folder.path()).unwrap(),
        dictionary
    );
}

#[test]
fn malformed_opencv_files_are_refused() {
    let same = TWO.replace("001010111", "\"101011001\"");
    for (text, expected) in [
        (
            TWO.replace("nmarkers: 2", "nmarkers: 3"),
            "nmarkers is 3, found 2",
        ),
        (TWO.replace("marker_1", "marker_2"), "no marker_1"),
        (TWO.replace("markersize: 3\n", ""), "no markersize"),
        (
            TWO.replace("markersize: 3", "markersize: three"),
            "whole number",
        ),
        (TWO.replace("001010111", "\"0010101\""), "3 × 3 digits"),
        (TWO.replace("001010111", "\"0010101x1\""), "3 × 3 digits"),
        (TWO.replace("markersize: 3", "markersize: 99999999999"), "9"),
        (TWO.replace("nmarkers: 2", "nmarkers: [2"), "cannot read"),
        (same, "same cells"),
        (String::new(), "the dictionary"),
    ] {
        let message = Dictionary::from_opencv("own.yml", &text).unwrap_err();
        assert!(message.to_string().contains(expected), "{message}");
    }
    let none = Dictionary::open("none.yaml", Path::new("/proc/nonexistent")).unwrap_err();
    assert_eq!(none.kind(), ErrorKind::NotFound);
}
