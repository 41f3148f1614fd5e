//! Tests of the steps from true values to a recording: clock, losses, converter and added errors.

use super::*;

#[test]
fn a_wrong_clock_samples_at_other_instants_and_does_not_say_so() {
    let (motion, unit, temperature) = (hand_motion(), Unit::ideal(), warming());
    let setup = hand_setup(&motion, &unit, &temperature);
    let fast = run(&Setup { faults: Faults { clock_rate_error: 0.01, ..Faults::none() }, ..setup }).unwrap();
    assert_eq!(fast.time_s.len(), (101.0 * motion.duration_s()).ceil() as usize);
    for i in [0, 500, 1234, 3000] {
        assert_eq!(fast.time_s[i], i as f64 / 100.0);
        let truth = motion.at(fast.time_s[i] / 1.01);
        assert_eq!(Vector3::from(fast.angular_rate[i]), truth.angular_rate);
    }
    assert!((fast.rests[1].0 - 1.01 * motion.rests()[1].0).abs() < 1e-12);

    // If a sample is taken late by the time dt, its angular rate changes by dt times the angular acceleration. `late`
    // is the ratio of dt to its standard deviation `jitter_s`, so it must be a standard normal number.
    let jitter_s = 1e-5;
    let shaken = run(&Setup { faults: Faults { clock_jitter_s: jitter_s, ..Faults::none() }, ..setup }).unwrap();
    let steady = run(&setup).unwrap();
    assert_eq!(shaken.time_s, steady.time_s);
    let late = (0..steady.time_s.len()).map(|i| {
        let change = Vector3::from(shaken.angular_rate[i]) - Vector3::from(steady.angular_rate[i]);
        let acceleration = Vector3::from(steady.true_angular_acceleration[i]);
        change.dot(&acceleration) / acceleration.norm_squared() / jitter_s
    });
    let late: Vec<f64> = late.collect();
    let power = late.iter().map(|late| late * late).sum::<f64>() / late.len() as f64;
    assert!((power - 1.0).abs() < 4.0 * (2.0 / late.len() as f64).sqrt() + 0.01, "{power}");
}

#[test]
fn lost_and_repeated_samples_are_counted_and_truth_stays_with_its_stamp() {
    let (motion, temperature) = (stand_motion(), warming());
    let unit = Unit::paper();
    let setup = hand_setup(&motion, &unit, &temperature);
    let whole = run(&setup).unwrap();
    let faults = Faults { missing_share: 0.05, duplicated_share: 0.1, ..Faults::none() };
    let spoiled = run(&Setup { faults, ..setup }).unwrap();
    let n = whole.time_s.len();
    assert!(spoiled.missing > 0 && spoiled.duplicated > 0);
    assert_eq!(spoiled.time_s.len(), n - spoiled.missing);
    assert_eq!(spoiled.stand_rad.as_ref().unwrap().len(), n - spoiled.missing);
    let mut repeated = 0;
    for (i, time_s) in spoiled.time_s.iter().enumerate() {
        let row = (time_s * 100.0).round() as usize;
        assert_eq!(*time_s, whole.time_s[row]);
        assert_eq!(spoiled.true_specific_force[i], whole.true_specific_force[row]);
        assert_eq!(spoiled.temperature_degc[i], whole.temperature_degc[row]);
        repeated += usize::from(spoiled.angular_rate[i] != whole.angular_rate[row]);
    }
    // Some of the repeated samples are also lost, so the recording contains fewer repeats than were drawn.
    assert!(repeated <= spoiled.duplicated && repeated as f64 > 0.8 * spoiled.duplicated as f64);
}

#[test]
fn what_the_user_adds_comes_before_the_sensor() {
    let (motion, unit, temperature) = (stand_motion(), Unit::paper(), warming());
    let setup = hand_setup(&motion, &unit, &temperature);
    let mut quiet = unit;
    quiet.gyroscope.converter = None;
    let setup = Setup { unit: &quiet, ..setup };
    let plain = run(&setup).unwrap();
    let rate: Vec<[f64; 3]> = plain.time_s.iter().map(|time_s| [1e-3 * time_s, 0.0, -0.01]).collect();
    let added = run(&Setup { added: Some(Added { force: None, rate: Some(&rate) }), ..setup }).unwrap();
    for i in 0..plain.time_s.len() {
        let change = Vector3::from(added.angular_rate[i]) - Vector3::from(plain.angular_rate[i]);
        assert!((change - quiet.gyroscope.sensitivity * Vector3::from(rate[i])).norm() < 1e-14);
    }
    assert_eq!(added.specific_force, plain.specific_force);
    assert_eq!(added.true_angular_rate, plain.true_angular_rate);
    let short = run(&Setup { added: Some(Added { force: None, rate: Some(&rate[1..]) }), ..setup });
    assert!(short.unwrap_err().to_string().contains("added rate has"));
}

#[test]
fn a_narrow_converter_clips_at_its_rails() {
    let (motion, temperature) = (stand_motion(), warming());
    let mut unit = Unit::ideal();
    let lsb = 1e-3;
    unit.gyroscope.converter = Some(Converter { lsb, bits: 11 });
    let run = run(&hand_setup(&motion, &unit, &temperature)).unwrap();
    let (mut low, mut high) = (0, 0);
    for (measured, truth) in run.angular_rate.as_flattened().iter().zip(run.true_angular_rate.as_flattened()) {
        let expected = truth.clamp(-1.024, 1.023);
        assert!((measured - expected).abs() <= lsb / 2.0 + 1e-12);
        low += usize::from(*truth < -1.03);
        high += usize::from(*truth > 1.03);
    }
    assert!(low > 10 && high > 10, "{low} and {high} samples at the rails");
}

#[test]
fn noise_grows_outside_of_rests_only() {
    let (motion, temperature) = (stand_motion(), warming());
    let mut unit = Unit::ideal();
    unit.gyroscope.noise_density = 1e-3;
    let quiet = run(&hand_setup(&motion, &unit, &temperature)).unwrap();
    unit.gyroscope.noise_in_motion = 3.0;
    let loud = run(&hand_setup(&motion, &unit, &temperature)).unwrap();
    for (i, time_s) in quiet.time_s.iter().enumerate() {
        let truth = Vector3::from(quiet.true_angular_rate[i]);
        let noise = |run: &Simulation| Vector3::from(run.angular_rate[i]) - truth;
        let resting = motion.rests().iter().any(|(start_s, end_s)| (*start_s..=*end_s).contains(time_s));
        let factor = if resting { 1.0 } else { 3.0 };
        assert!((noise(&loud) - noise(&quiet) * factor).norm() < 1e-14, "{time_s} s");
    }
}
