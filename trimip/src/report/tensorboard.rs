//! The scalars of a run as an event file of TensorBoard: a sequence of TFRecords, each an `Event` message of Protocol Buffers
//! (`tensorflow/core/lib/io/record_writer.h`, `tensorflow/core/util/event.proto` and `framework/summary.proto`).
//!
//! | tags | one point for |
//! |---|---|
//! | `train/loss`, `train/psnr`, `train/learning_rate`, `train/samples_per_second`, `train/rays_per_second`, `train/occupied` | each logged step |
//! | `eval/psnr_mean`, `eval/ssim_mean`, and per scale `eval/psnr_1`, `eval/ssim_1`, `eval/psnr_2`, .. | each evaluation of the curve |
//! | `test/` with the same names, and `test/ms_ssim_mean`, `test/flip_mean`, `test/lpips_mean` where they were measured | the final evaluation |
//!
//! PSNR is in dB. The wall time of a point is the time at which the run began plus the seconds of training, so that evaluations and
//! interruptions take no time, as in `error_vs_time.csv`. If no session has recorded its end, the run begins at the Unix epoch.

use crate::run::history::{Evaluation, History, SessionPart};
use trimip_core::{
    engine::events::{Event, Totals},
    measures::quality::mean_quality,
};

/// The version of the file, which its first record states.
const VERSION: &str = "brain.Event:2";

/// Keys of Protocol Buffers fields, written before the values: number of the field and type of its value, `number << 3 | type`.
mod key {
    /// `Event.wall_time`, f64.
    pub const WALL_TIME: u8 = (1 << 3) | 1;
    /// `Event.step`, varint.
    pub const STEP: u8 = 2 << 3;
    /// `Event.file_version`, text.
    pub const FILE_VERSION: u8 = (3 << 3) | 2;
    /// `Event.summary`, message.
    pub const SUMMARY: u8 = (5 << 3) | 2;
    /// `Summary.value`, message.
    pub const VALUE: u8 = (1 << 3) | 2;
    /// `Summary.Value.tag`, text.
    pub const TAG: u8 = (1 << 3) | 2;
    /// `Summary.Value.simple_value`, f32.
    pub const SIMPLE_VALUE: u8 = (2 << 3) | 5;
}

/// The scalars of one moment of a run.
struct Point {
    step: u64,
    /// Seconds of training.
    seconds: f64,
    /// Tags and values.
    scalars: Vec<(String, f64)>,
}

impl Point {
    fn new(totals: &Totals, scalars: Vec<(String, f64)>) -> Self {
        Self { step: totals.step, seconds: totals.seconds, scalars }
    }
}

/// Returns the bytes of the event file of a run: the step events among `events`, and the evaluations of `history`. Values that
/// are not finite are left out.
pub fn file(history: &History, events: &[Event]) -> Vec<u8> {
    let mut points: Vec<Point> = events.iter().filter_map(of_step).collect();
    points.extend(history.curve().into_iter().map(|e| Point::new(&e.totals, of_evaluation("eval", e))));
    points.extend(history.last().map(|e| Point::new(&e.totals, of_final_evaluation(e))));
    points.sort_by_key(|point| point.step);
    let began = history.parts.first().and_then(began).unwrap_or(0.0);
    let mut bytes = Vec::new();
    put_record(&mut bytes, &version(began));
    for point in &points {
        let message = event(began + point.seconds, point.step, &point.scalars);
        message.iter().for_each(|message| put_record(&mut bytes, message));
    }
    bytes
}

/// Returns the Unix time at which a session began, in seconds.
fn began(part: &SessionPart) -> Option<f64> {
    part.provenance.ended_unix.map(|ended| ended as f64 - part.wall_seconds)
}

fn of_step(event: &Event) -> Option<Point> {
    let Event::Step {
        totals,
        loss,
        batch_psnr,
        learning_rate,
        samples_per_second,
        rays_per_second,
        occupied,
        ..
    } = event
    else {
        return None;
    };
    let scalars = [
        ("loss", *loss),
        ("psnr", *batch_psnr),
        ("learning_rate", *learning_rate),
        ("samples_per_second", *samples_per_second),
        ("rays_per_second", *rays_per_second),
        ("occupied", *occupied),
    ];
    let named = scalars.into_iter().map(|(name, value)| (format!("train/{name}"), value));
    Some(Point::new(totals, named.collect()))
}

/// Returns PSNR and SSIM of an evaluation: their means, and the values of each scale.
fn of_evaluation(group: &str, evaluation: &Evaluation) -> Vec<(String, f64)> {
    let mut scalars = vec![
        (format!("{group}/psnr_mean"), evaluation.psnr),
        (format!("{group}/ssim_mean"), evaluation.ssim),
    ];
    for quality in &evaluation.scales {
        scalars.push((format!("{group}/psnr_{}", quality.scale), quality.measures.psnr));
        scalars.push((format!("{group}/ssim_{}", quality.scale), quality.measures.ssim));
    }
    scalars
}

fn of_final_evaluation(evaluation: &Evaluation) -> Vec<(String, f64)> {
    let (mut scalars, mean) = (of_evaluation("test", evaluation), mean_quality(&evaluation.scales));
    for (name, value) in [("ms_ssim", mean.ms_ssim), ("flip", mean.flip), ("lpips", mean.lpips)] {
        scalars.push((format!("test/{name}_mean"), value));
    }
    scalars
}

/// Returns the message that begins a file.
fn version(wall_time: f64) -> Vec<u8> {
    let mut message = vec![key::WALL_TIME];
    message.extend(wall_time.to_le_bytes());
    put_bytes(&mut message, key::FILE_VERSION, VERSION.as_bytes());
    message
}

/// Returns an `Event` message with the finite values among `scalars`; `None` if no value is finite.
fn event(wall_time: f64, step: u64, scalars: &[(String, f64)]) -> Option<Vec<u8>> {
    let mut summary = Vec::new();
    for (tag, value) in scalars.iter().filter(|(_, value)| value.is_finite()) {
        let mut entry = Vec::new();
        put_bytes(&mut entry, key::TAG, tag.as_bytes());
        entry.push(key::SIMPLE_VALUE);
        entry.extend((*value as f32).to_le_bytes());
        put_bytes(&mut summary, key::VALUE, &entry);
    }
    if summary.is_empty() {
        return None;
    }
    let mut message = vec![key::WALL_TIME];
    message.extend(wall_time.to_le_bytes());
    message.push(key::STEP);
    put_varint(&mut message, step);
    put_bytes(&mut message, key::SUMMARY, &summary);
    Some(message)
}

/// Appends a field of bytes: its key, its length, its value.
fn put_bytes(to: &mut Vec<u8>, key: u8, value: &[u8]) {
    to.push(key);
    put_varint(to, value.len() as u64);
    to.extend(value);
}

/// Appends a number as a varint: groups of seven bits, the lowest first; all bytes except the last have their highest bit set.
fn put_varint(to: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        to.push(value as u8 | 0x80);
        value >>= 7;
    }
    to.push(value as u8);
}

/// Appends a TFRecord: length, its checksum, `data`, its checksum; all little-endian.
fn put_record(to: &mut Vec<u8>, data: &[u8]) {
    let length = (data.len() as u64).to_le_bytes();
    to.extend(length);
    to.extend(masked(crc32c(&length)).to_le_bytes());
    to.extend(data);
    to.extend(masked(crc32c(data)).to_le_bytes());
}

/// Masks a checksum as TFRecords store it, so that the checksum of data that contain checksums is no special value.
fn masked(checksum: u32) -> u32 {
    checksum.rotate_right(15).wrapping_add(0xA282_EAD8)
}

/// Computes CRC-32C: the reflected polynomial 0x82F63B78 (Castagnoli). Zip archives and PNGs use another polynomial, so their crates do not
/// compute this checksum. A file has some kilobytes, so one bit at a time is fast enough.
fn crc32c(bytes: &[u8]) -> u32 {
    let divided = |rest: u32, _| (rest >> 1) ^ if rest & 1 == 1 { 0x82F6_3B78 } else { 0 };
    !bytes.iter().fold(!0, |rest, &byte| (0..8).fold(rest ^ u32::from(byte), divided))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::fixtures::{evaluation, step};
    use trimip_core::engine::events::Provenance;

    #[test]
    fn checksums_are_those_of_crc_32c() {
        // RFC 3720, B.4, and the check value of the catalogue of parametrised CRC algorithms.
        assert_eq!(crc32c(b"123456789"), 0xE306_9283);
        assert_eq!(crc32c(&[0; 32]), 0x8A91_36AA);
        assert_eq!(crc32c(&[0xFF; 32]), 0x62A8_AB43);
        let rising: Vec<u8> = (0..32).collect();
        assert_eq!(crc32c(&rising), 0x46DD_794E);
        assert_eq!(crc32c(b""), 0);
    }

    /// Checks the checksums of all records and returns their payloads.
    fn records(mut bytes: &[u8]) -> Vec<&[u8]> {
        let mut found = Vec::new();
        while !bytes.is_empty() {
            let (length, rest) = bytes.split_at(8);
            let (checksum, rest) = rest.split_at(4);
            assert_eq!(checksum, masked(crc32c(length)).to_le_bytes());
            let (data, rest) = rest.split_at(u64::from_le_bytes(length.try_into().unwrap()) as usize);
            let (checksum, rest) = rest.split_at(4);
            assert_eq!(checksum, masked(crc32c(data)).to_le_bytes());
            found.push(data);
            bytes = rest;
        }
        found
    }

    /// A field of a message.
    #[derive(Debug, PartialEq)]
    enum Field<'a> {
        Varint(u64),
        Fixed64([u8; 8]),
        Fixed32([u8; 4]),
        Bytes(&'a [u8]),
    }

    fn varint(bytes: &mut &[u8]) -> u64 {
        let mut value = 0;
        for shift in (0..).step_by(7) {
            let (byte, rest) = bytes.split_first().unwrap();
            *bytes = rest;
            value |= u64::from(byte & 0x7F) << shift;
            if byte & 0x80 == 0 {
                break;
            }
        }
        value
    }

    /// Returns the numbers and values of the fields of a message.
    fn fields(mut bytes: &[u8]) -> Vec<(u64, Field<'_>)> {
        let mut found = Vec::new();
        while !bytes.is_empty() {
            let key = varint(&mut bytes);
            let value = match key & 7 {
                0 => Field::Varint(varint(&mut bytes)),
                1 => Field::Fixed64(*bytes.split_off(..8).unwrap().first_chunk().unwrap()),
                2 => {
                    let length = varint(&mut bytes) as usize;
                    Field::Bytes(bytes.split_off(..length).unwrap())
                }
                5 => Field::Fixed32(*bytes.split_off(..4).unwrap().first_chunk().unwrap()),
                other => panic!("type {other}"),
            };
            found.push((key >> 3, value));
        }
        found
    }

    /// Returns the wall time, step, tag and value of each scalar of a file.
    fn scalars(bytes: &[u8]) -> Vec<(f64, u64, String, f32)> {
        let mut found = Vec::new();
        for record in &records(bytes)[1..] {
            let event = fields(record);
            let [(1, Field::Fixed64(time)), (2, Field::Varint(step)), (5, Field::Bytes(summary))] = event[..]
            else {
                panic!("{event:?}");
            };
            for value in fields(summary) {
                let (1, Field::Bytes(value)) = value else { panic!("{value:?}") };
                let value = fields(value);
                let [(1, Field::Bytes(tag)), (2, Field::Fixed32(simple))] = value[..] else {
                    panic!("{value:?}");
                };
                let tag = String::from_utf8(tag.to_vec()).unwrap();
                found.push((f64::from_le_bytes(time), step, tag, f32::from_le_bytes(simple)));
            }
        }
        found
    }

    #[test]
    fn a_file_holds_the_scalars_of_the_run_in_the_order_of_steps() {
        let ended = Event::SessionEnded {
            device: "two cores".into(),
            backend: "cpu".into(),
            wall_seconds: 20.0,
            peak_memory_bytes: None,
            provenance: Provenance { ended_unix: Some(1_000_020), ..Provenance::default() },
        };
        let events = [
            step(5, 50, 500, 400),
            step(300, 3000, 900, 800),
            evaluation(10, 25, false, 20.0),
            evaluation(300, 25, false, 25.0),
            evaluation(300, 1, true, f64::NAN),
            ended,
        ];
        let bytes = file(&History::of(&events), &events);
        let version = fields(records(&bytes)[0]);
        assert_eq!(
            version,
            [(1, Field::Fixed64(1e6_f64.to_le_bytes())), (3, Field::Bytes(b"brain.Event:2".as_slice()))]
        );
        let found = scalars(&bytes);
        let of = |tag: &str| -> Vec<(f64, u64, f32)> {
            found.iter().filter(|other| other.2 == tag).map(|other| (other.0, other.1, other.3)).collect()
        };
        assert_eq!(of("train/loss"), [(1_000_005.0, 5, 0.25), (1_000_300.0, 300, 0.25)]);
        assert_eq!(of("train/samples_per_second")[0].2, 1000.0);
        assert_eq!(of("train/rays_per_second")[0].2, 10.0);
        assert_eq!(of("train/learning_rate")[0].2, 0.002);
        assert_eq!(of("train/occupied")[0].2, 0.125);
        assert_eq!(of("train/psnr"), [], "infinite");
        assert_eq!(of("eval/psnr_mean"), [(1_000_001.0, 10, 20.0), (1_000_030.0, 300, 25.0)]);
        assert_eq!(of("eval/psnr_2")[1].2, 26.0);
        assert_eq!(of("eval/ssim_1")[0].2, 0.9);
        assert_eq!((of("test/psnr_mean").len(), of("test/flip_mean").len()), (0, 0), "not finite");
        assert_eq!(of("test/ssim_mean"), [(1_000_030.0, 300, 0.9)]);
        assert!(found.is_sorted_by_key(|other| other.1), "{found:?}");
    }

    #[test]
    fn a_run_of_which_nothing_is_known_has_a_file_with_its_version_alone() {
        assert_eq!(records(&file(&History::default(), &[])).len(), 1);
    }
}
