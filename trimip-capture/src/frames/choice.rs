//! Chooses the frames of a film: the sharpest in each interval of motion.

use super::measure::Measured;
use trimip::formatting::{count, duration};

/// Chosen frames per second of film if the user gives no number, and the minimum and maximum number of frames.
const RATE: f64 = 2.0;
const FEWEST: f64 = 50.0;
const MOST: f64 = 300.0;

/// Minimum motion between two frames that count as different, relative to the longest side of the picture.
const LEAST_STEP: f64 = 0.01;

/// Fraction by which the score of a frame is lowered at the end of its interval, compared with the middle. It keeps chosen frames from
/// lying next to each other.
const AT_THE_END: f64 = 0.3;

/// Maximum number of intervals per requested frame.
const NARROWEST: usize = 32;

/// If at least this share of all frames is requested, frames without motion between them are taken too.
const NEARLY_ALL: f64 = 0.8;

/// Minimum change of exposure between neighbouring chosen frames that is reported, in stops; and maximum number of changes that are listed.
const JUMP: f64 = 0.5;
const NAMED: usize = 3;

/// Exponent from grey levels to linear light.
const GAMMA: f64 = 2.2;

/// The frames that are taken.
#[derive(Debug, PartialEq)]
pub struct Chosen {
    /// Frame numbers, increasing.
    pub frames: Vec<usize>,
    /// Reasons for the choice, as lines for the user.
    pub notes: Vec<String>,
}

/// Chooses frames; `wanted` is the number that the user requested.
pub fn choose(measured: &[Measured], wanted: Option<u32>) -> Chosen {
    let last = measured.last().map_or(0.0, |frame| frame.seconds);
    let motion = measured.last().map_or(0.0, |frame| frame.motion);
    let by_time = (RATE * last).clamp(FEWEST, MOST).round();
    let by_motion = (motion / LEAST_STEP).floor().max(2.0);
    let (count, why) = match wanted {
        Some(wanted) => (f64::from(wanted), "as asked for".to_string()),
        None if by_motion < by_time => {
            (by_motion, "the camera moves so little that more frames would look alike".to_string())
        }
        None => (by_time, format!("{RATE} a second, {FEWEST} to {MOST}")),
    };
    let number = (count as usize).min(measured.len());
    let frames = as_many(measured, number);
    let mut notes = vec![format!(
        "frames: {} of {}, the sharpest of each interval of equal motion ({why}; --frames N)",
        frames.len(),
        measured.len()
    )];
    notes.extend(still(measured, last));
    notes.extend(jumps(measured, &frames));
    Chosen { frames, notes }
}

/// Chooses `count` frames, spread over the motion. If a film moves unevenly, some intervals hold no frame; the function then tries narrower
/// intervals and drops the frames that add the least motion. It takes only one of several frames without motion between them, unless nearly
/// all frames are requested.
fn as_many(measured: &[Measured], count: usize) -> Vec<usize> {
    let mut frames: Vec<usize> = (0..measured.len()).collect();
    if (count as f64) < NEARLY_ALL * measured.len() as f64 {
        let mut intervals = count;
        frames = sharpest(measured, intervals);
        while frames.len() < count && intervals < NARROWEST * count {
            intervals += 1 + intervals / 8;
            frames = sharpest(measured, intervals);
        }
    }
    while frames.len() > count.max(2) {
        // The value of a frame: the motion between its neighbours, then its own sharpness.
        let worth = |place: usize| {
            let motion = measured[frames[place + 1]].motion - measured[frames[place - 1]].motion;
            (motion, measured[frames[place]].sharpness)
        };
        let least = (1..frames.len() - 1).min_by(|&a, &b| {
            let (a, b) = (worth(a), worth(b));
            a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1))
        });
        let Some(least) = least else { break };
        frames.remove(least);
    }
    frames
}

/// Returns the sharpest frame of each of `count` intervals. The intervals have equal motion, or equal time if the film has no motion; empty
/// intervals yield no frame.
fn sharpest(measured: &[Measured], count: usize) -> Vec<usize> {
    let motion = measured.last().map_or(0.0, |frame| frame.motion);
    let place = |index: usize| match motion > 0.0 {
        true => measured[index].motion / motion,
        false => index as f64 / measured.len() as f64,
    };
    let mut best: Vec<Option<(f64, usize)>> = vec![None; count];
    for (index, frame) in measured.iter().enumerate() {
        let place = place(index) * count as f64;
        let interval = (place.floor() as usize).min(count.saturating_sub(1));
        let from_middle = (place - interval as f64 - 0.5).abs().min(0.5);
        let score = frame.sharpness * (1.0 - 2.0 * AT_THE_END * from_middle);
        let Some(slot) = best.get_mut(interval) else { continue };
        if slot.is_none_or(|(other, _)| score > other) {
            *slot = Some((score, index));
        }
    }
    best.into_iter().flatten().map(|(_, index)| index).collect()
}

/// Reports for how long nothing moves in the film.
fn still(measured: &[Measured], last: f64) -> Option<String> {
    let still = |pair: &[Measured]| pair[1].motion <= pair[0].motion;
    // Motion is measured at only some frames, so only stretches longer than a second count as pauses.
    let (mut seconds, mut began) = (0.0, None);
    for pair in measured.windows(2) {
        match (still(pair), began) {
            (true, None) => began = Some(pair[0].seconds),
            (false, Some(begin)) => {
                let length = pair[0].seconds - begin;
                seconds += if length > 1.0 { length } else { 0.0 };
                began = None;
            }
            _ => {}
        }
    }
    seconds += began.map_or(0.0, |begin| last - begin);
    (seconds > 1.0 && seconds > 0.05 * last).then(|| {
        format!(
            "frames: nothing moves in {} of {}; each such pause gives at most one frame",
            duration(seconds),
            duration(last)
        )
    })
}

/// Reports chosen frames whose exposure differs from that of the previous chosen frame.
fn jumps(measured: &[Measured], frames: &[usize]) -> Option<String> {
    let stops = |from: usize, to: usize| {
        GAMMA * ((measured[to].brightness + 1.0) / (measured[from].brightness + 1.0)).log2()
    };
    let jumps: Vec<(f64, f64)> = frames
        .windows(2)
        .map(|pair| (measured[pair[1]].seconds, stops(pair[0], pair[1])))
        .filter(|(_, stops)| stops.abs() >= JUMP)
        .collect();
    if jumps.is_empty() {
        return None;
    }
    let mut named: Vec<String> = jumps
        .iter()
        .take(NAMED)
        .map(|(at, stops)| format!("{stops:+.1} stops at {}", duration(*at)))
        .collect();
    if jumps.len() > NAMED {
        named.push(format!("{} more", jumps.len() - NAMED));
    }
    Some(format!(
        "exposure: {} between neighbours: {}; lock the exposure while filming, or train with loss.exposure = \"gain\"",
        count(jumps.len() as u64, "jump"),
        named.join(", ")
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(index: usize, motion: f64, sharpness: f64) -> Measured {
        Measured { seconds: index as f64 / 10.0, sharpness, brightness: 100.0, motion }
    }

    #[test]
    fn the_sharpest_of_each_interval_is_taken() {
        // One minute, in which every seventh frame is sharp.
        let film: Vec<_> =
            (0..600).map(|i| frame(i, 0.01 * i as f64, if i % 7 == 3 { 100.0 } else { 10.0 })).collect();
        let chosen = choose(&film, Some(60));
        assert!(chosen.frames.len() == 60 && chosen.frames.iter().all(|i| i % 7 == 3), "{:?}", chosen.frames);
        assert!(chosen.frames.windows(2).all(|pair| pair[1] > pair[0]));
        assert_eq!(choose(&film, None).frames.len(), 120, "two a second");
        let few = choose(&film[..50], None).frames.len();
        assert!((48..50).contains(&few), "{few}, no more than the motion gives");
    }

    #[test]
    fn uneven_motion_takes_no_frames_away() {
        // Fifty photographs in sequence: some steps are ten times as long as others, and every fifth step has no motion.
        let mut motion = 0.0;
        let film: Vec<_> = (0..50)
            .map(|i| {
                motion += if i % 5 == 0 { 0.0 } else { 0.02 * (1 + i * 7 % 10) as f64 };
                frame(i, motion, 50.0)
            })
            .collect();
        assert_eq!(choose(&film, None).frames, (0..50).collect::<Vec<_>>());
        for wanted in [45, 30, 20] {
            let frames = choose(&film, Some(wanted)).frames;
            assert_eq!(frames.len(), wanted as usize, "{frames:?}");
            assert!(frames.windows(2).all(|pair| pair[1] > pair[0]), "{frames:?}");
        }
    }

    #[test]
    fn frames_follow_motion_and_not_time() {
        // The camera stands still for half of the film.
        let film: Vec<_> = (0..600).map(|i| frame(i, 0.02 * i.saturating_sub(300) as f64, 50.0)).collect();
        let chosen = choose(&film, None);
        let early = chosen.frames.iter().filter(|&&index| index < 300).count();
        assert!(early <= 1 && chosen.frames.len() > 100, "{early} of {}", chosen.frames.len());
        assert!(chosen.notes.iter().any(|note| note.contains("nothing moves in 30 s")), "{:?}", chosen.notes);
    }

    #[test]
    fn a_film_that_does_not_move_gives_few_frames() {
        let film: Vec<_> = (0..600).map(|i| frame(i, 0.0, 50.0)).collect();
        let chosen = choose(&film, None);
        assert!(chosen.frames.len() == 2 && chosen.notes[0].contains("moves so little"), "{chosen:?}");
        assert_eq!(choose(&film, Some(10)).frames.len(), 10);
        assert_eq!(choose(&film[..3], Some(10)).frames, [0, 1, 2]);
        assert_eq!(choose(&[], None).frames, [0_usize; 0]);
    }

    #[test]
    fn jumps_of_exposure_are_told() {
        let mut film: Vec<_> = (0..100).map(|i| frame(i, 0.02 * i as f64, 50.0)).collect();
        assert!(!choose(&film, Some(50)).notes.iter().any(|note| note.starts_with("exposure")));
        film[50..].iter_mut().for_each(|frame| frame.brightness = 150.0);
        let notes = choose(&film, Some(50)).notes;
        assert!(notes.iter().any(|note| note.contains("1 jump") && note.contains("+1.3 stops")), "{notes:?}");
    }
}
