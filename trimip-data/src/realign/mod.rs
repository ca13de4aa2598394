//! Detached parts of a model from structure from motion. Where a scene repeats itself, as in the pattern of a carpet, feature matches
//! join photographs that show different places, and a mapper places a part of the photographs around a second copy of the scene. Each
//! part fits its own photographs, so no reprojection error shows the mistake; jumps between photographs taken one after the other do.
//!
//! [`realign`] looks for jumps in the path of the cameras across which few points are shared. If the photographs on both sides of a jump
//! look alike, and their points agree on one similarity that the model does not have, the part on one side is moved by this similarity.
//! The part stays if the two parts share too many points to be detached, or if the move would not bring the cameras on both sides of the
//! jump close together. Points of both parts that look alike are then joined, and bundle adjustment fits all cameras to them.

mod bundle;
mod cholesky;
mod covisibility;
mod patches;
mod similarity;

use crate::{
    points::{Observation, Point},
    source::map_in_order,
};
use bundle::{Bundle, Seen, triangulate};
use covisibility::Covisibility;
use glam::DVec3;
pub(crate) use patches::Gray;
use patches::{Match, Patches};
use rayon::prelude::*;
use similarity::Similarity;
use std::collections::{BTreeMap, HashMap};
use trimip_core::{
    Camera, Result,
    math::rng::{Random, Sequence, below},
    plural::count,
};

/// Least and largest number of frames of a model that is examined.
const FRAMES: [usize; 2] = [8, 4000];

/// Most frames of a model whose cameras are adjusted. With more, the linear system of the adjustment takes gigabytes.
const MOST_ADJUSTED: usize = 700;

/// A jump is a step from one frame to the next that is longer than `JUMP` times the median step, and across which the
/// frames share less than `FEW_SHARED` times the median number of shared points.
const JUMP: f64 = 3.0;
const FEW_SHARED: f64 = 0.25;

/// Largest link between the two sides of a jump (`Covisibility::link`). Detached parts share only the few points that
/// were matched wrongly: their link is 0.026 in *bonsai*, where parts of one walk have links of 0.08 and more.
const LOOSE: f64 = 0.05;

/// Most jumps that are examined, and most parts that are moved.
const MOST_JUMPS: usize = 16;
const MOST_PARTS: usize = 4;

/// Most patches of a frame at a jump, and most patches of a frame whose points are joined.
const PATCHES: [usize; 2] = [2000, 1000];

/// Least number of matches that agree on a similarity, and their least share of all matches: between the frames at a
/// jump, between a second pair of frames there, and between frames whose points are joined.
const AGREED: [(usize, f64); 3] = [(60, 0.6), (30, 0.4), (12, 0.4)];

/// If the model is wrong at a jump, at most this share of the matches across the jump agrees with the model as it is.
const IN_PLACE: f64 = 0.1;

/// Largest reprojection distance of a match that agrees with a similarity, as a fraction of the longer side of the photograph.
const TOLERANCE: f64 = 0.005;

/// Number of random samples of three matches, each of which gives a similarity.
const SAMPLES: u32 = 400;

/// Number of frames of other parts whose points are joined with those of a frame.
const NEIGHBOURS: usize = 4;

/// Number of observations of each frame in the adjustment: of joined points, and of other points. Long tracks come first.
const OBSERVATIONS: [usize; 2] = [300, 300];

/// Huber's threshold and the largest error of an observation that is kept, as multiples of the model's median error.
const HUBER: f64 = 3.0;
const LARGEST_ERROR: f64 = 8.0;

/// Largest median error of an adjusted model, and of its joined points, as multiples of the median error before the
/// adjustment. Parts that do not belong together exceed these.
const ADJUSTED: [f64; 2] = [1.5, 3.0];

/// A model with detached parts.
pub(crate) struct Torn {
    /// The model with aligned parts; `None` if they cannot be aligned.
    pub(crate) aligned: Option<Aligned>,
    /// The findings, in words.
    pub(crate) warning: String,
}

/// A model whose parts are aligned.
pub(crate) struct Aligned {
    pub(crate) cameras: Vec<Camera>,
    /// Points with the tracks of the model, except for observations that do not fit the aligned model.
    pub(crate) points: Vec<Point>,
}

/// A model from structure from motion, with its photographs.
pub(crate) struct Model<'a> {
    pub(crate) names: Vec<&'a str>,
    pub(crate) cameras: Vec<Camera>,
    /// Points with tracks of frames.
    pub(crate) points: Vec<Point>,
    /// Decodes the photograph of a frame.
    pub(crate) picture: &'a (dyn Fn(usize) -> Result<Gray> + Sync),
}

/// A jump across which the model is wrong.
struct Jump {
    /// The frames on both sides.
    frames: [usize; 2],
    /// Maps the scene of the first frame's part to that of the second frame's part.
    similarity: Similarity,
    /// Number of matches that agree, and number of all matches.
    agreed: [usize; 2],
}

/// Aligns detached parts of a model; `None` if there are none. The result has the same bits for any number of threads.
///
/// # Errors
/// If a photograph cannot be decoded.
pub(crate) fn realign(mut model: Model<'_>) -> Result<Option<Torn>> {
    let frames = model.cameras.len();
    let tracked = model.points.iter().any(|point| point.track.len() > 1);
    if !tracked || !(FRAMES[0]..=FRAMES[1]).contains(&frames) {
        return Ok(None);
    }
    let mut parts = vec![0_usize; frames];
    let mut told = Vec::new();
    while told.len() < MOST_PARTS {
        let Some((jump, moved)) = model.find_jump()? else { break };
        let side = moved[jump.frames[0]];
        let similarity = if side { jump.similarity } else { jump.similarity.inverse() };
        let [first, last] = jump.frames;
        let distance = (model.cameras[first].origin - model.cameras[last].origin).length();
        model.separate(&moved);
        model.shift(&moved, &similarity);
        told.push(format!(
            "{} of {frames} photographs were detached from the others: {} of {} matches between {} and {} agree that these two are {:.2} units apart, \
             not {distance:.2}",
            moved.iter().filter(|is_moved| **is_moved).count(),
            jump.agreed[0],
            jump.agreed[1],
            model.names[first],
            model.names[last],
            (model.cameras[first].origin - model.cameras[last].origin).length(),
        ));
        let next = parts.iter().max().map_or(1, |most| most + 1);
        // If a piece of a part is moved again, the piece is a new part.
        let mut new = HashMap::new();
        for (part, _) in parts.iter_mut().zip(&moved).filter(|(_, moved)| **moved) {
            let after = next + new.len();
            *part = *new.entry(*part).or_insert(after);
        }
    }
    if told.is_empty() {
        return Ok(None);
    }
    let told = told.join("; ");
    let advice = "run COLMAP again, with sequential matching for a film";
    if frames > MOST_ADJUSTED {
        let warning =
            format!("{told}. Models of more than {MOST_ADJUSTED} photographs are not aligned: {advice}");
        return Ok(Some(Torn { aligned: None, warning }));
    }
    // Moving cameras and their points by one similarity changes no reprojection error, so these errors are the model's own.
    let usual = median(model.errors());
    let joined = model.join(&parts)?;
    if joined.len() < AGREED[0].0 {
        let warning =
            format!("{told}. Only {} of both parts look alike: {advice}", count(joined.len(), "point"));
        return Ok(Some(Torn { aligned: None, warning }));
    }
    let [all, of_joined] = model.adjust(&joined, usual);
    if all > ADJUSTED[0] * usual || of_joined > ADJUSTED[1] * usual {
        let warning = format!(
            "{told}. The aligned parts do not fit together ({of_joined:.2} pixels of error instead of {usual:.2}): {advice}"
        );
        return Ok(Some(Torn { aligned: None, warning }));
    }
    let warning = format!(
        "{told}. The parts are aligned and all cameras adjusted ({} joined; median reprojection error {all:.2} instead of {usual:.2} pixels); \
         data.realign = false keeps the model as it is",
        count(joined.len(), "point"),
    );
    Ok(Some(Torn { aligned: Some(Aligned { cameras: model.cameras, points: model.points }), warning }))
}

impl Model<'_> {
    /// Returns all reprojection errors.
    fn errors(&self) -> Vec<f64> {
        self.points.iter().flat_map(|point| errors(point, &self.cameras)).collect()
    }

    /// Returns the points that each frame saw.
    fn seen(&self) -> Vec<Vec<u32>> {
        let mut seen = vec![Vec::new(); self.cameras.len()];
        for (index, point) in self.points.iter().enumerate() {
            point.track.iter().for_each(|own| seen[own.view as usize].push(index as u32));
        }
        seen
    }

    /// Finds the longest jump across which the model is wrong. Returns it with the smaller of the two sides that it divides.
    fn find_jump(&self) -> Result<Option<(Jump, Vec<bool>)>> {
        let covisibility = Covisibility::of(self.cameras.len(), &self.points);
        let order = self.in_order();
        let step = |pair: &[usize]| (self.cameras[pair[1]].origin - self.cameras[pair[0]].origin).length();
        let steps: Vec<f64> = order.windows(2).map(step).collect();
        let usual = median(steps.clone());
        let shared = |i: usize| f64::from(covisibility.shared(order[i], order[i + 1]));
        let usually_shared = median((0..steps.len()).map(shared).collect());
        let mut jumps: Vec<usize> = (0..steps.len())
            .filter(|&i| steps[i] > JUMP * usual && shared(i) < FEW_SHARED * usually_shared)
            .collect();
        jumps.sort_by(|&a, &b| steps[b].total_cmp(&steps[a]).then(a.cmp(&b)));
        let seen = self.seen();
        for before in jumps.into_iter().take(MOST_JUMPS) {
            let frames = [order[before], order[before + 1]];
            let mut side = covisibility.side(frames[0], frames[1]);
            if covisibility.link(&side) > LOOSE {
                continue;
            }
            if 2 * side.iter().filter(|own| **own).count() > side.len() {
                side.iter_mut().for_each(|own| *own = !*own);
            }
            let [first, last] = frames.map(|frame| self.cameras[frame].origin);
            let found = self.examine(&order, before, &seen)?;
            // If the scene really has two places that look alike, the frames are far apart even after the move.
            if let Some(jump) =
                found.filter(|jump| (jump.similarity.of(first) - last).length() <= JUMP * usual)
            {
                return Ok(Some((jump, side)));
            }
        }
        Ok(None)
    }

    /// Returns the frames sorted by name, with numbers compared by value. Cameras and phones number photographs as they take them.
    fn in_order(&self) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.names.len()).collect();
        order.sort_by_cached_key(|&frame| parts_of_name(self.names[frame]));
        order
    }

    /// Returns the similarity on which the photographs on both sides of a jump agree, if the model contradicts it. The
    /// jump follows index `before` of the frames in `order`.
    fn examine(&self, order: &[usize], before: usize, seen: &[Vec<u32>]) -> Result<Option<Jump>> {
        let frames = [order[before], order[before + 1]];
        let [first, last] = frames;
        let patches = |frame: usize| self.patches(frame, &seen[frame], PATCHES[0]);
        let [one, other] = [patches(first)?, patches(last)?];
        let matches = one.matches(&other);
        let Some((similarity, agreeing)) = self.agreement(&matches, last, AGREED[0]) else { return Ok(None) };
        let counts = [agreeing.len(), matches.len()];
        let in_place =
            matches.iter().filter(|found| self.distance(found, last, None) < self.tolerance(last)).count();
        if in_place as f64 > IN_PLACE * matches.len() as f64 {
            return Ok(None);
        }
        // The frames of another pair must agree on the same similarity.
        let pairs = [
            (before.checked_sub(1).map(|earlier| order[earlier]), Some(last)),
            (Some(first), order.get(before + 2).copied()),
        ];
        for (a, b) in pairs {
            let (Some(a), Some(b)) = (a, b) else { continue };
            let matches = match a == first {
                true => one.matches(&patches(b)?),
                false => patches(a)?.matches(&other),
            };
            let fits = |found: &&Match| self.distance(found, b, Some(&similarity)) < 2.0 * self.tolerance(b);
            let agreed = matches.iter().filter(fits).count();
            if enough(agreed, matches.len(), AGREED[1]) {
                return Ok(Some(Jump { frames, similarity, agreed: counts }));
            }
        }
        Ok(None)
    }

    fn patches(&self, frame: usize, own: &[u32], most: usize) -> Result<Patches> {
        Ok(Patches::new(&(self.picture)(frame)?, frame as u32, own, &self.points, most))
    }

    /// Returns the largest reprojection distance in `frame` of matches that agree, pixels.
    fn tolerance(&self, frame: usize) -> f64 {
        let k = &self.cameras[frame].intrinsics;
        TOLERANCE * f64::from(k.width.max(k.height))
    }

    /// Returns the distance in pixels between the place where `frame`, the second frame of a match, saw its point, and
    /// the projection of the first frame's point after the move `by`.
    fn distance(&self, found: &Match, frame: usize, by: Option<&Similarity>) -> f64 {
        let point = DVec3::from(self.points[found.points[0] as usize].position);
        let position = by.map_or(point, |by| by.of(point));
        let seen = Observation { view: frame as u32, at: found.at };
        seen.error(position, &self.cameras[frame]).unwrap_or(f64::INFINITY)
    }

    /// Finds the similarity on which most matches agree, and these matches (RANSAC, Fischler and Bolles 1981).
    fn agreement(
        &self,
        matches: &[Match],
        frame: usize,
        least: (usize, f64),
    ) -> Option<(Similarity, Vec<Match>)> {
        if matches.len() < least.0.max(3) {
            return None;
        }
        let position = |index: u32| DVec3::from(self.points[index as usize].position);
        let fitted = |chosen: &[Match]| {
            let [from, to] =
                [0, 1].map(|i| chosen.iter().map(|own| position(own.points[i])).collect::<Vec<_>>());
            Similarity::fit(&from, &to)
        };
        let tolerance = self.tolerance(frame);
        let agreeing = |similarity: &Similarity| -> Vec<Match> {
            let fits = |found: &&Match| self.distance(found, frame, Some(similarity)) < tolerance;
            matches.iter().filter(fits).copied().collect()
        };
        let random = Random::new(frame as u64);
        let mut best: Vec<Match> = Vec::new();
        for sample in 0..SAMPLES {
            let drawn = random.bits(Sequence::Sample, 0, sample);
            let chosen = [0, 1, 2].map(|i| matches[below(drawn[i], matches.len() as u32) as usize]);
            let found = fitted(&chosen).map(|similarity| agreeing(&similarity)).unwrap_or_default();
            if found.len() > best.len() {
                best = found;
            }
        }
        // A fit to all matches that agree is more accurate than a fit to three.
        let mut similarity = fitted(&best)?;
        for _ in 0..3 {
            let found = agreeing(&similarity);
            if found.len() < best.len() {
                break;
            }
            similarity = fitted(&found)?;
            best = found;
        }
        enough(best.len(), matches.len(), least).then_some((similarity, best))
    }

    /// Restricts each track to the frames of one side: the side with fewer observations is dropped.
    fn separate(&mut self, side: &[bool]) {
        for point in &mut self.points {
            let own = point.track.iter().filter(|seen| side[seen.view as usize]).count();
            let kept = 2 * own > point.track.len();
            point.track.retain(|seen| side[seen.view as usize] == kept);
        }
        self.points.retain(|point| point.track.len() > 1);
    }

    /// Moves the frames of a side, and the points that they saw.
    fn shift(&mut self, side: &[bool], similarity: &Similarity) {
        for (camera, _) in self.cameras.iter_mut().zip(side).filter(|(_, own)| **own) {
            *camera = similarity.of_camera(camera);
        }
        for point in &mut self.points {
            if side[point.track[0].view as usize] {
                point.position = similarity.of(point.position.into()).to_array();
            }
        }
    }

    /// Joins points of different parts that look alike, and returns the joined ones. A point that was merged into
    /// another has no track left.
    fn join(&mut self, parts: &[usize]) -> Result<Vec<u32>> {
        let seen = self.seen();
        let moved = (0..parts.len()).filter(|&frame| parts[frame] > 0);
        let mut pairs: Vec<[usize; 2]> = moved
            .flat_map(|frame| {
                self.neighbours(frame, parts).map(move |other| [frame.min(other), frame.max(other)])
            })
            .collect();
        pairs.sort_unstable();
        pairs.dedup();
        let mut frames: Vec<usize> = pairs.iter().flatten().copied().collect();
        frames.sort_unstable();
        frames.dedup();
        let patches = map_in_order(&frames, |_, &frame| self.patches(frame, &seen[frame], PATCHES[1]))?;
        let patches: HashMap<usize, Patches> = frames.into_iter().zip(patches).collect();
        let found: Vec<Vec<Match>> = pairs
            .par_iter()
            .map(|&[frame, other]| {
                let matches = patches[&frame].matches(&patches[&other]);
                self.agreement(&matches, other, AGREED[2]).map(|(_, agreeing)| agreeing).unwrap_or_default()
            })
            .collect();
        // Pairs of points, sorted by the number of pairs of frames that match them; each point is joined once.
        let mut votes: BTreeMap<[u32; 2], u32> = BTreeMap::new();
        for Match { points: [a, b], .. } in found.into_iter().flatten() {
            *votes.entry([a.min(b), a.max(b)]).or_default() += 1;
        }
        let mut ordered: Vec<([u32; 2], u32)> = votes.into_iter().collect();
        ordered.sort_by_key(|(points, votes)| (std::cmp::Reverse(*votes), *points));
        let mut is_joined = vec![false; self.points.len()];
        let mut joined = Vec::new();
        for ([a, b], _) in ordered {
            let [own, other] = [a, b].map(|index| index as usize);
            if is_joined[own] || is_joined[other] {
                continue;
            }
            (is_joined[own], is_joined[other]) = (true, true);
            let track = std::mem::take(&mut self.points[other].track);
            let [from, to] = [other, own].map(|index| DVec3::from(self.points[index].position));
            let share = track.len() as f64 / (track.len() + self.points[own].track.len()) as f64;
            self.points[own].position = to.lerp(from, share).to_array();
            let new = track
                .into_iter()
                .filter(|seen| self.points[own].track.iter().all(|old| old.view != seen.view));
            let new: Vec<Observation> = new.collect();
            self.points[own].track.extend(new);
            joined.push(a);
        }
        Ok(joined)
    }

    /// Returns the frames of other parts whose cameras are nearest to that of `frame` in position and direction.
    fn neighbours(&self, frame: usize, parts: &[usize]) -> impl Iterator<Item = usize> + use<> {
        let own = &self.cameras[frame];
        let reach = median(self.cameras.iter().map(|camera| (camera.origin - own.origin).length()).collect());
        let difference = |other: &Camera| {
            let turned = own.rotation.z_axis.angle_between(other.rotation.z_axis);
            (own.origin - other.origin).length() / reach.max(f64::MIN_POSITIVE) + turned
        };
        let mut others: Vec<(f64, usize)> = (0..parts.len())
            .filter(|&other| parts[other] != parts[frame])
            .map(|other| (difference(&self.cameras[other]), other))
            .collect();
        others.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        others.into_iter().take(NEIGHBOURS).map(|(_, other)| other)
    }

    /// Adjusts all cameras to the joined points and to some of the others, and then all points to the cameras. `usual`
    /// is the median error before the adjustment. Returns the median errors of all points and of the joined ones.
    fn adjust(&mut self, joined: &[u32], usual: f64) -> [f64; 2] {
        let chosen = self.chosen(joined);
        let seen = |index: &u32| {
            let point = &self.points[*index as usize];
            Seen { position: point.position.into(), track: point.track.clone() }
        };
        let huber = HUBER * usual;
        let mut points: Vec<Seen> = chosen.iter().map(seen).collect();
        Bundle::new(&mut self.cameras, huber).adjust(&mut points);
        for (index, point) in chosen.iter().zip(points) {
            self.points[*index as usize].position = point.position.to_array();
        }
        let cameras = &self.cameras;
        self.points.par_iter_mut().filter(|point| !point.track.is_empty()).for_each(|point| {
            let mut seen = Seen { position: point.position.into(), track: std::mem::take(&mut point.track) };
            triangulate(&mut seen, cameras, huber);
            point.position = seen.position.to_array();
            point.track = seen.track;
        });
        let of_joined =
            joined.iter().flat_map(|index| errors(&self.points[*index as usize], cameras)).collect();
        let medians = [median(self.errors()), median(of_joined)];
        let most = LARGEST_ERROR * usual;
        for point in &mut self.points {
            let position = point.position.into();
            point.track.retain(|seen| {
                seen.error(position, &cameras[seen.view as usize]).is_some_and(|error| error <= most)
            });
            let errors = errors(point, cameras);
            point.error = Some(errors.iter().sum::<f64>() / errors.len().max(1) as f64);
            point.seen = Some(point.track.len());
        }
        self.points.retain(|point| point.track.len() > 1);
        medians
    }

    /// Chooses points for the adjustment: joined ones first, then those with the longest tracks, until each frame has enough of both kinds.
    fn chosen(&self, joined: &[u32]) -> Vec<u32> {
        let length = |index: &u32| (std::cmp::Reverse(self.points[*index as usize].track.len()), *index);
        let is_joined: std::collections::HashSet<u32> = joined.iter().copied().collect();
        let others: Vec<u32> =
            (0..self.points.len() as u32).filter(|index| !is_joined.contains(index)).collect();
        let mut chosen = Vec::new();
        for (group, enough) in [joined.to_vec(), others].into_iter().zip(OBSERVATIONS) {
            let mut group = group;
            group.sort_by_key(length);
            let mut counts = vec![0; self.cameras.len()];
            for index in group {
                let track = &self.points[index as usize].track;
                if track.iter().any(|seen| counts[seen.view as usize] < enough) {
                    track.iter().for_each(|seen| counts[seen.view as usize] += 1);
                    chosen.push(index);
                }
            }
        }
        chosen
    }
}

/// Splits a name into the texts between its numbers, each with the number that follows.
fn parts_of_name(name: &str) -> Vec<(&str, u64)> {
    let mut parts = Vec::new();
    let mut rest = name;
    while !rest.is_empty() {
        let (text, after) = rest.split_at(rest.find(|c: char| c.is_ascii_digit()).unwrap_or(rest.len()));
        let (number, after) =
            after.split_at(after.find(|c: char| !c.is_ascii_digit()).unwrap_or(after.len()));
        parts.push((text, number.parse().unwrap_or(0)));
        rest = after;
    }
    parts
}

/// Returns true if at least `least` matches agree, and at least the share `share` of all matches.
fn enough(agreed: usize, all: usize, (least, share): (usize, f64)) -> bool {
    agreed >= least && agreed as f64 >= share * all as f64
}

/// Returns the reprojection errors of a point.
fn errors(point: &Point, cameras: &[Camera]) -> Vec<f64> {
    let position = point.position.into();
    point.track.iter().filter_map(|seen| seen.error(position, &cameras[seen.view as usize])).collect()
}

/// Returns the median of some values, or 0 if there are none.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::parts_of_name;

    #[test]
    fn numbers_in_names_are_compared_by_their_value() {
        let mut names = [
            "b/1",
            "walk10",
            "walk9b",
            "walk9",
            "a/07",
            "walk9b2",
            "a/7x",
            "",
            "a/123456789012345678901234567890",
        ];
        names.sort_by_key(|name| parts_of_name(name));
        assert_eq!(
            names,
            [
                "",
                "a/123456789012345678901234567890",
                "a/07",
                "a/7x",
                "b/1",
                "walk9",
                "walk9b",
                "walk9b2",
                "walk10"
            ]
        );
    }
}
