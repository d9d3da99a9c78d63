//! Boards of other programs.

use super::*;
use gripcast_base::error::ErrorKind;

const ROS: &str = "\
- name: \"GridBoard_1\"
  frame_at_center: true
  first_id: 10
  markers_x: 3
  markers_y: 4
  marker_size: 0.03
  separation: 0.005
- name: corner
  frame_at_center: false
  first_id: 0
  markers_x: 1
  markers_y: 2
  marker_size: 0.04
  separation: 0.01
";
const KALIBR: &str = "\
target_type: 'aprilgrid' #gridtype
tagCols: 6               #number of apriltags
tagRows: 5
tagSize: 0.088           #size of apriltag, edge to edge [m]
tagSpacing: 0.3          #ratio of space between tags to tagSize
";

fn dictionary() -> Dictionary {
    Dictionary::by_name("4X4_50").unwrap()
}

#[test]
fn ros_grid_ids_start_at_top_left() {
    let boards = import_ros(ROS, &dictionary()).unwrap().boards;
    assert_eq!(boards.len(), 2);
    let grid = &boards[0].board;
    assert_eq!(grid.ids(), (10..22).collect::<Vec<u32>>());
    let corner = |id: u32, k: usize| {
        let marker = grid.markers.iter().find(|m| m.id == id).unwrap();
        1e3 * marker.corners_m[k]
    };
    // 100 × 135 mm, the origin at the centre.
    assert!(corner(10, 0).distance(DVec3::new(-50.0, 67.5, 0.0)) < 1e-9);
    assert!(corner(12, 1).distance(DVec3::new(50.0, 67.5, 0.0)) < 1e-9);
    assert!(corner(21, 2).distance(DVec3::new(50.0, -67.5, 0.0)) < 1e-9);
    let below = &boards[1].board.markers[1];
    assert!((1e3 * below.corners_m[3]).distance(DVec3::ZERO) < 1e-9);
    assert!(grid.is_planar(Body::Object));
}

#[test]
fn kalibr_grid_ids_start_at_bottom_left() {
    let file = import_kalibr(KALIBR, "grid", None).unwrap();
    assert_eq!(file.board.dictionary, "36h11_border2");
    assert_eq!(file.board.markers.len(), 30);
    let corner = |id: usize, k: usize| 1e3 * file.board.markers[id].corners_m[k];
    assert!(corner(0, 3).distance(DVec3::ZERO) < 1e-9);
    assert!(corner(1, 3).distance(DVec3::new(114.4, 0.0, 0.0)) < 1e-9);
    assert!(corner(6, 3).distance(DVec3::new(0.0, 114.4, 0.0)) < 1e-9);
    let one = Dictionary::by_name("36h11").unwrap();
    let other = import_kalibr(KALIBR, "grid", Some(&one)).unwrap();
    assert_eq!(other.board.dictionary, "36h11");
}

#[test]
fn kalibr_family_and_first_id_are_read() {
    let text = KALIBR.replacen(
        "tagCols: 6",
        "tagFamily: 't16h5'\ncodeOffset: 5\ntagCols: 4",
        1,
    );
    let file = import_kalibr(&text, "grid", None).unwrap();
    assert_eq!(file.board.dictionary, "16h5_border2");
    assert_eq!(file.board.ids(), (5..25).collect::<Vec<u32>>());
}

#[test]
fn kalibr_checkerboard_is_a_chessboard_without_markers() {
    let text = "%YAML:1.0\n---\ntarget_type: 'checkerboard'\ntargetCols: 6\ntargetRows: 7\n\
                rowSpacingMeters: 0.06\ncolSpacingMeters: 0.06\n";
    let file = import_kalibr(text, "checks", None).unwrap();
    let chessboard = file.chessboard.unwrap();
    assert_eq!(chessboard.squares, [7, 8]);
    assert_eq!(chessboard.square_mm, [60.0, 60.0]);
    assert!(file.board.markers.is_empty());
}

#[test]
fn other_types_of_ros_boards_are_listed() {
    let text = format!("{ROS}- name: odd\n  type: custom\n  markers:\n    - id: 3\n");
    let imported = import_ros(&text, &dictionary()).unwrap();
    assert_eq!(imported.boards.len(), 2);
    assert_eq!(imported.unsupported[0].0, "odd");
}

const ARUCO_MAP: &str = "%YAML:1.0\n---\naruco_bc_dict: ARUCO_MIP_36h12\naruco_bc_nmarkers: 1\n\
    aruco_bc_mInfoType: 1\naruco_bc_markers:\n   - { id:7, corners:[ [ -0.1, 0.1, 0. ], [ 0.1, \
    0.1, 0. ], [ 0.1, -0.1, 0. ], [ -0.1, -0.1, 0. ] ] }\n";

#[test]
fn aruco_map_is_read() {
    assert_eq!(
        BoardFormat::detect(ARUCO_MAP).unwrap(),
        BoardFormat::ArucoMap
    );
    let file = import_aruco_map(ARUCO_MAP, "map", None).unwrap();
    assert_eq!(file.board.dictionary, "DICT_ARUCO_MIP_36h12");
    assert_eq!(file.board.ids(), [7]);
    assert!((file.board.markers[0].side_m() - 0.2).abs() < 1e-12);
    for (from, to, expected) in [
        ("nmarkers: 1", "nmarkers: 2", "found 1 markers"),
        ("mInfoType: 1", "mInfoType: 0", "in pixels"),
        ("ARUCO_MIP_36h12", "CHILITAGS", "\"CHILITAGS\""),
        ("0.1, 0. ], [ 0.1, ", "0.3, 0. ], [ 0.1, ", "not a square"),
    ] {
        let text = ARUCO_MAP.replacen(from, to, 1);
        let error = import_aruco_map(&text, "map", None)
            .unwrap_err()
            .to_string();
        assert!(error.contains(expected), "{from}: {error}");
    }
}

#[test]
fn invalid_ros_boards_are_refused() {
    for (from, to, expected) in [
        (
            "marker_size: 0.03",
            "marker_size: 30",
            "millimetres where metres",
        ),
        (
            "marker_size: 0.03",
            "marker_size: 3",
            "centimetres where metres",
        ),
        ("separation: 0.005", "separation: 5", "gap of 5"),
        ("separation: 0.005", "separation: -0.005", "gap of -0.005"),
        ("first_id: 10", "first_id: 45", "exceeds DICT_4X4_50"),
        ("markers_x: 3", "markers_x: 0", "from 1 to 1024"),
        ("markers_x: 3", "markers_x: 4000000000", "from 1 to 1024"),
        ("  markers_y: 4\n", "", "markers_y"),
        ("name: corner", "name: GridBoard_1", "two boards are named"),
        ("frame_at_center: true", "frame_at_center: [", "cannot read"),
    ] {
        assert!(ROS.contains(from));
        let text = ROS.replacen(from, to, 1);
        let message = import_ros(&text, &dictionary()).unwrap_err().to_string();
        assert!(message.contains(expected), "{from} → {to}: {message}");
    }
    let message = import_ros("[]", &dictionary()).unwrap_err().to_string();
    assert!(message.contains("empty"), "{message}");
    assert!(import_ros("name: x", &dictionary()).is_err());
}

#[test]
fn invalid_kalibr_targets_are_refused() {
    for (from, to, expected) in [
        ("'aprilgrid'", "'circlegrid'", "target type \"circlegrid\""),
        ("'aprilgrid'", "'checkerboard'", "no targetCols"),
        ("tagSpacing: 0.3", "tagSpacing: 0.0264", "write 0.3000"),
        (
            "tagCols: 6",
            "tagFamily: t25h7\ntagCols: 6",
            "tagFamily \"t25h7\"",
        ),
        (
            "tagCols: 6",
            "tagFamily: t16h5\ntagCols: 7",
            "exceeds 16h5_border2",
        ),
        (
            "tagCols: 6",
            "startId: 570\ntagCols: 6",
            "from id 570 exceeds",
        ),
        (
            "tagSize: 0.088 ",
            "tagSize: 88 ",
            "millimetres where metres",
        ),
        ("tagSpacing: 0.3", "tagSpacing: 26.4", "fraction of tagSize"),
        ("tagRows: 5\n", "", "no tagRows"),
        ("tagCols: 6", "tagCols: 200", "exceeds 36h11"),
    ] {
        let text = KALIBR.replacen(from, to, 1);
        let message = import_kalibr(&text, "g", None).unwrap_err().to_string();
        assert!(message.contains(expected), "{from} → {to}: {message}");
    }
}

#[test]
fn truncated_or_damaged_files_give_board_or_input_error() {
    let rejected = |error: Error| {
        assert_eq!(error.kind(), ErrorKind::Input, "{error}");
        0
    };
    // Number of boards read; each was validated against its dictionary.
    let read = |text: &str| {
        let ros = import_ros(text, &dictionary()).map_or_else(rejected, |all| all.boards.len());
        let kalibr = import_kalibr(text, "g", None).map_or_else(rejected, |_| 1);
        ros + kalibr
    };
    for (text, count) in [(ROS, 2), (KALIBR, 1)] {
        assert_eq!(read(text), count);
        for at in 0..text.len() {
            let cut = &text[..at];
            assert!(read(cut) <= count, "{cut}");
            for byte in ["[", ":", "-", "9", "&a", "*a", "\0"] {
                let damaged = format!("{}{byte}{}", cut, &text[at + 1..]);
                assert!(read(&damaged) <= count, "{damaged}");
            }
        }
        // Without its first key the file is invalid.
        let (_, rest) = text.split_once(':').unwrap();
        assert_eq!(read(rest), 0);
    }
}

#[test]
fn format_is_detected_from_keys() {
    let kind = |text: &str| BoardFormat::detect(text).unwrap();
    assert_eq!(kind(ROS), BoardFormat::Ros);
    assert_eq!(kind(KALIBR), BoardFormat::Kalibr);
    let dictionary = "%YAML:1.0\nnmarkers: 3\nmarkersize: 4\n";
    assert_eq!(kind(dictionary), BoardFormat::OpencvDictionary);
    let message = BoardFormat::detect("camera: 3").unwrap_err().to_string();
    assert!(message.contains("target_type"), "{message}");
}
