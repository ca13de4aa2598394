//! Which frames see the same points.

use crate::points::Point;

/// Number of points that each pair of frames shares.
pub(super) struct Covisibility {
    frames: usize,
    /// Number of shared points, [frames, frames].
    shared: Vec<u32>,
}

impl Covisibility {
    /// Counts the tracks of `points`.
    pub(super) fn of(frames: usize, points: &[Point]) -> Self {
        let mut shared = vec![0; frames * frames];
        for point in points {
            for a in &point.track {
                point.track.iter().for_each(|b| shared[a.view as usize * frames + b.view as usize] += 1);
            }
        }
        Self { frames, shared }
    }

    /// Returns the number of points that both frames saw.
    pub(super) fn shared(&self, a: usize, b: usize) -> u32 {
        self.shared[a * self.frames + b]
    }

    /// Returns how strongly two sides are linked: a numerator divided by a denominator. The numerator counts shared
    /// points over all pairs of frames with one frame on each side. The denominator counts them over all pairs within
    /// one side, that with the smaller count. `side` has an entry for each frame.
    pub(super) fn link(&self, side: &[bool]) -> f64 {
        let mut sums = [0.0; 3];
        for a in 0..self.frames {
            for b in 0..a {
                let which = if side[a] == side[b] { usize::from(side[a]) } else { 2 };
                sums[which] += f64::from(self.shared(a, b));
            }
        }
        sums[2] / sums[0].min(sums[1]).max(1.0)
    }

    /// Divides the frames between `a` and `b` at the weakest link of the path from one to the other in the maximum
    /// spanning tree (Kruskal). Returns true for the frames on the side of `a`. The strength of a link is the number of
    /// shared points, divided by the number of points of the frame that has fewer.
    pub(super) fn side(&self, a: usize, b: usize) -> Vec<bool> {
        let mut links: Vec<(f64, usize, usize)> = Vec::new();
        for i in 0..self.frames {
            for j in i + 1..self.frames {
                if self.shared(i, j) > 0 {
                    let fewer = self.shared(i, i).min(self.shared(j, j)).max(1);
                    links.push((f64::from(self.shared(i, j)) / f64::from(fewer), i, j));
                }
            }
        }
        links.sort_by(|one, other| {
            other.0.total_cmp(&one.0).then(one.1.cmp(&other.1)).then(one.2.cmp(&other.2))
        });
        let mut sets = Sets((0..self.frames).collect());
        for (_, i, j) in links {
            let (i, j, a, b) = (sets.of(i), sets.of(j), sets.of(a), sets.of(b));
            if (i, j) != (a, b) && (i, j) != (b, a) {
                sets.0[i.max(j)] = i.min(j);
            }
        }
        let own = sets.of(a);
        (0..self.frames).map(|frame| sets.of(frame) == own).collect()
    }
}

/// Disjoint sets: each frame refers to another frame of its set, and the root to itself.
struct Sets(Vec<usize>);

impl Sets {
    fn of(&mut self, mut frame: usize) -> usize {
        while self.0[frame] != frame {
            self.0[frame] = self.0[self.0[frame]];
            frame = self.0[frame];
        }
        frame
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::Observation;

    fn seen_by(views: &[u32]) -> Point {
        let track = views.iter().map(|&view| Observation { view, at: [0.0; 2] }).collect();
        Point { position: [0.0; 3], color: [0; 3], error: None, seen: None, track }
    }

    #[test]
    fn frames_are_divided_at_the_weakest_link() {
        // The frames 0 to 5 are in a row. Frames 2 and 3 share few points, and so do 0 and 5, and 1 and 3.
        let mut points = Vec::new();
        for (views, times) in
            [([0, 1], 9), ([1, 2], 8), ([2, 3], 2), ([3, 4], 7), ([4, 5], 9), ([0, 5], 1), ([1, 3], 1)]
        {
            points.extend((0..times).map(|_| seen_by(&views)));
        }
        let covisibility = Covisibility::of(7, &points);
        assert_eq!(
            [covisibility.shared(1, 2), covisibility.shared(2, 1), covisibility.shared(0, 3)],
            [8, 8, 0]
        );
        let expected = [true, true, true, false, false, false, false];
        assert_eq!(covisibility.side(2, 3), expected);
        assert_eq!(covisibility.side(0, 5), expected);
        // 2 + 1 + 1 points are shared across the link, 9 + 8 within one side and 7 + 9, the smaller count, within the other.
        assert_eq!(covisibility.link(&expected), 4.0 / 16.0);
        assert_eq!(covisibility.side(4, 1)[..6], expected.map(|side| !side)[..6]);
    }
}
