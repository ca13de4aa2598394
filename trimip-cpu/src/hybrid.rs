//! Hybrid rendering on the CPU: the densities of the proxy determine where a ray has samples.

use crate::buffer::Buffer;
use crate::cursor::Cursor;
use crate::march::advance;
use crate::occupancy::CpuOccupancy;
use crate::worker::Groups;
use crate::{CpuBackend, CpuField};
use std::ops::Range;
use trimip_core::Field;
use trimip_core::engine::batch::{Interval, Radiance, Ray, Samples, Segment, Sphere, Workspace};
use trimip_core::engine::policy::RendererPolicy;
use trimip_core::engine::proxy::{Chooser, Chosen, Guide, Layering, Pick, Shaded, share_colors};
use trimip_core::geometry::space::Path;

/// Hybrid rendering with the proxy of a model.
pub(crate) struct Hybrid(pub Guide);

impl Hybrid {
    /// Calls `place` for every sample of a ray, front to back. Returns false if the ray's cone is too wide for the
    /// proxy; the caller then discards the placed samples.
    #[inline(always)]
    pub fn choose(
        &self,
        policy: &RendererPolicy,
        ray: &Ray,
        occupancy: &CpuOccupancy,
        place: impl FnMut(Interval, Sphere),
    ) -> bool {
        match self.0.layers {
            None => self.pick(Chooser::new(self.0.rule), policy, ray, occupancy, place),
            Some(layers) => self.pick(Layering::new(layers), policy, ray, occupancy, place),
        }
    }

    #[inline(always)]
    fn pick(
        &self,
        mut chooser: impl Pick,
        policy: &RendererPolicy,
        ray: &Ray,
        occupancy: &CpuOccupancy,
        mut place: impl FnMut(Interval, Sphere),
    ) -> bool {
        let guide = &self.0;
        let mut cursor = Cursor::new(policy, ray, None, 0).with_step(guide.step);
        let way = policy.space.straight_path(ray, occupancy.resolution());
        let mut choose = |chosen: Chosen| {
            let Chosen { t, .. } = chosen;
            place(
                Interval { t, length: chosen.length(guide.step) },
                Sphere { position: way.position(t), radius: way.radius(t) },
            );
        };
        let mut sure = true;
        advance(policy, ray, occupancy, &mut cursor, |Interval { t, .. }, sphere, _| {
            // The spheres of a wide cone may touch cells with density even where its axis misses them.
            if sphere.radius > guide.widest {
                sure = false;
                return false;
            }
            let code = guide.proxy.code(sphere.position);
            if code == 0 {
                return true;
            }
            let [depth, alpha] = guide.steps[usize::from(code)];
            !chooser.step(t, depth, alpha, &mut choose)
        });
        if sure {
            chooser.end(&mut choose);
        }
        sure
    }

    /// Groups the samples that share a colour, in all rays for which `sure` is true. The first sample of a group gets the optical
    /// depth, length and weighted mean distance of the group, and its row in the field context gets the weighted mean of the
    /// geometry features. `kept` lists the first sample of each group.
    pub fn blend(
        &self,
        field: &CpuField,
        workspace: &mut Workspace<CpuBackend>,
        sure: &[bool],
        groups: &mut Groups,
    ) {
        let Workspace { stream, samples, field_context, radiance, kept, .. } = workspace;
        let Samples { segments, intervals, .. } = samples;
        kept.clear();
        groups.fractions.clear();
        groups.fractions.resize(radiance.len(), 1.0);
        for (segment, &sure) in segments.iter_mut().zip(sure) {
            let (rows, start) = (segment.range(), kept.len());
            if sure {
                self.group(rows, intervals, radiance, kept, groups);
            } else {
                rows.for_each(|row| kept.push(row as u32));
            }
            *segment = Segment { start: start as u32, count: (kept.len() - start) as u32 };
        }
        if kept.len() < radiance.len() {
            field.blend(field_context, kept, &groups.fractions);
            samples.rays.keep_rows(kept, 1);
            samples.intervals.keep_rows(kept, 1);
            samples.spheres.keep_rows(kept, 1);
            field.keep(stream, kept, field_context, radiance);
        }
    }

    /// Groups the samples `rows` of a ray.
    fn group(
        &self,
        rows: Range<usize>,
        intervals: &mut [Interval],
        radiance: &mut [Radiance],
        kept: &mut Buffer<u32>,
        Groups { samples, fractions }: &mut Groups,
    ) {
        let first = rows.start;
        samples.clear();
        samples.extend(rows.map(|row| {
            let Interval { t, length } = intervals[row];
            Shaded { t, depth: radiance[row].density * length, weight: 0.0 }
        }));
        share_colors(&self.0.rule, samples, |range, group| {
            let own = first + range.start;
            kept.push(own as u32);
            let sum: f32 = group.iter().map(|sample| sample.weight).sum();
            // A group without weight is invisible, and its first sample represents it unchanged.
            if group.len() == 1 || !(sum > 0.0) {
                return;
            }
            let (mut depth, mut moment, mut length) = (0.0, 0.0, 0.0);
            for (row, sample) in (own..).zip(group) {
                let fraction = sample.weight / sum;
                fractions[row] = if row == own { fraction } else { -fraction.max(f32::MIN_POSITIVE) };
                depth += sample.depth;
                moment += sample.weight * sample.t;
                length += intervals[row].length;
            }
            intervals[own] = Interval { t: moment / sum, length };
            radiance[own].density = depth / length;
        });
    }
}
