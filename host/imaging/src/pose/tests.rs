use super::*;

fn frame(time_s: f64, position: f64) -> FrameFields {
    FrameFields {
        time_s: Some(time_s),
        numbers: [("Probe".to_owned(), position)].into(),
        ..FrameFields::default()
    }
}

#[test]
fn positions_that_lag_are_read_later() {
    let fields: Vec<FrameFields> = (0..5).map(|i| frame(f64::from(i), 10.0 * f64::from(i))).collect();
    let position_field = Place::Field { name: "Probe".to_owned(), start_mm: 70.0, sign: 1.0 };
    let poses = Poses::new(5, &fields, &position_field).expect("the field is there");
    assert_eq!(placed_at(3, 0.0, &poses), [1.0, -2.0, 100.0]);
    assert!((placed_at(3, 0.25, &poses)[2] - 102.5).abs() < 1e-9);
    assert_eq!(placed_at(4, 0.25, &poses)[2], 110.0);
    // The probe is above the needle.
    let Motion { beam_rad, mm_per_s } = poses.motion(3, 0.25).expect("a pose");
    assert!((beam_rad.to_degrees() + 90.0).abs() < 1e-9 && (mm_per_s - 10.0).abs() < 1e-9);
}

fn placed_at(frame: usize, lag_s: f64, poses: &Poses) -> [f64; 3] {
    placed(&poses.of(frame, lag_s).expect("a pose"), [1.0, 2.0])
}

fn stamped(stamps_s: &[f64]) -> Vec<FrameFields> {
    stamps_s.iter().enumerate().map(|(i, time_s)| frame(*time_s, i as f64)).collect()
}

#[test]
fn a_clock_that_steps_back_or_stands_still_is_an_error_at_its_frame() {
    let speed = Place::Speed { start_mm: 70.0, mm_per_s: 1.0 };
    let field = Place::Field { name: "Probe".to_owned(), start_mm: 70.0, sign: 1.0 };
    for place in [&speed, &field] {
        for (stamps_s, words) in [
            (&[100.0, 101.0, 102.0, 82.0, 83.0][..], "frame 4: a time stamp of 82 s after 102 s"),
            (&[100.0, 99.999, 101.0], "frame 2: a time stamp of 99.999 s after 100 s"),
            (&[5.0, 5.0, 5.0], "frame 2: a time stamp of 5 s after 5 s"),
        ] {
            let error = Poses::new(stamps_s.len(), &stamped(stamps_s), place).expect_err(words).to_string();
            assert!(error.contains(words), "{error}");
        }
    }
    // A stamp once more: that frame alone has no place.
    let fields = stamped(&[0.5, 1.5, 1.5, 2.5]);
    let poses = Poses::new(4, &fields, &speed).expect("a clock");
    let z_mm = [0, 1, 2, 3].map(|frame: usize| poses.of(frame, 0.0).map(|pose| pose[11]));
    assert_eq!(z_mm, [Some(70.0), Some(71.0), None, Some(72.0)]);
    // Whole seconds at two frames a second, tenths at thirty: a field needs no clock, a speed does.
    for stamps_s in [&[7.0, 8.0, 8.0, 9.0][..], &[0.1, 0.1, 0.1, 0.2, 0.2, 0.2]] {
        let fields = stamped(stamps_s);
        let error = Poses::new(stamps_s.len(), &fields, &speed).expect_err("too few digits").to_string();
        assert!(error.contains("tell frames apart") && error.contains("--step-mm"), "{error}");
        let poses = Poses::new(stamps_s.len(), &fields, &field).expect("places");
        assert!(!poses.has_times() && poses.of(3, 0.0).is_some_and(|pose| pose[11] == 73.0));
    }
    // If the number of the frame determines its position, no clock is needed.
    let step = Place::Step { start_mm: 70.0, step_mm: 0.5 };
    let poses = Poses::new(5, &stamped(&[100.0, 101.0, 102.0, 82.0, 83.0]), &step).expect("places");
    assert!(poses.of(4, 0.0).is_some_and(|pose| pose[11] == 72.0) && !poses.has_times());
    // The origin of the clock is of no meaning.
    let large_times: Vec<f64> = [0.0, 1.0, 2.0].map(|s| s + 1.764e9).to_vec();
    let poses = Poses::new(3, &stamped(&large_times), &speed).expect("a clock");
    assert_eq!(poses.of(2, 0.0).map(|pose| pose[11]), Some(72.0));
}

#[test]
fn a_probe_that_never_moves_was_not_seen() {
    let fields: Vec<FrameFields> = (0..4).map(|i| frame(f64::from(i), 12.5)).collect();
    let position_field = Place::Field { name: "Probe".to_owned(), start_mm: 70.0, sign: 1.0 };
    let error = Poses::new(4, &fields, &position_field).expect_err("still").to_string();
    assert!(error.contains("Probe is the same in all 4 frames"), "{error}");
}

#[test]
fn the_last_row_decides_the_order_of_a_transform() {
    let mut rows = across(5.0);
    (rows[1], rows[4], rows[3]) = (0.5, -0.25, 7.0);
    let mut columns = rows;
    columns.iter_mut().enumerate().for_each(|(at, value)| *value = rows[4 * (at % 4) + at / 4]);
    assert_eq!([by_rows(rows), by_rows(columns)], [Some(rows); 2]);
    let mut no_last_row = rows;
    (no_last_row[12], no_last_row[15]) = (3.0, 2.0);
    assert_eq!(by_rows(no_last_row), None);
    assert_eq!(by_rows([f64::NAN; 16]), None);
}

#[test]
fn names_the_fields_there_are() {
    let position_field = Place::Field { name: "Stage".to_owned(), start_mm: 0.0, sign: 1.0 };
    let error = Poses::new(1, &[frame(0.0, 1.0)], &position_field).expect_err("no such field");
    assert!(error.to_string().contains("expected one of: Probe"), "{error}");
}

#[test]
fn transforms_are_chained_from_image_to_guide() {
    let mut rotated = across(5.0);
    rotated[3] = 2.0;
    let fields =
        FrameFields { transforms: [("ProbeToTracker".to_owned(), rotated)].into(), ..FrameFields::default() };
    let mut shift = across(0.0);
    shift[11] = 100.0;
    let transform_field = Place::Transform {
        name: "ProbeToTracker".to_owned(),
        image_to_probe: Box::new(across(0.0)),
        tracker_to_guide: Box::new(shift),
    };
    let poses = Poses::new(1, &[fields], &transform_field).expect("the transform is there");
    assert_eq!(placed(&poses.of(0, 0.0).expect("a pose"), [1.0, 3.0]), [3.0, -3.0, 105.0]);
}
