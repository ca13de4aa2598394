//! The content of a comparison, from which its page, JSON, Markdown and LaTeX are made.

use super::means::{TableRow, scene_row, whole_row};
use super::runs::{Run, Scales, Status};
use trimip::machine::Machine;
use trimip::systems::System;

/// The content of a comparison.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// The systems, in the order of the tables.
    pub systems: Vec<&'static System>,
    /// Names of the scenes, in order.
    pub scenes: Vec<String>,
    /// Names of Blender scenes that are missing; empty if the scenes were named one by one.
    pub missing: Vec<&'static str>,
    /// The tables, in order.
    pub scales: Vec<Scales>,
    /// Splits that are trained on.
    pub split: Vec<String>,
    /// The budget of a run in words.
    pub budget: String,
    /// All runs, including waiting ones.
    pub runs: Vec<Run>,
    /// The machine.
    pub machine: Machine,
    /// Command line.
    pub command: Option<String>,
}

impl Comparison {
    /// Returns the runs of a cell of a table: a system on a scene, with all seeds.
    pub fn runs_of(&self, scales: Scales, scene: &str, system: &str) -> Vec<&Run> {
        self.runs
            .iter()
            .filter(|run| run.scales == scales && run.scene == scene && run.system == system)
            .collect()
    }

    /// Returns one row per system for a scene.
    pub fn scene_rows(&self, scales: Scales, scene: &str) -> Vec<TableRow> {
        self.systems
            .iter()
            .map(|system| scene_row(system, scales, scene, &self.runs_of(scales, scene, system.name)))
            .collect()
    }

    /// Returns one row per system for the whole comparison: the mean over the scenes of each scene's mean.
    pub fn whole_rows(&self, scales: Scales) -> Vec<TableRow> {
        let of_system = |system: &&'static System| {
            let rows: Vec<TableRow> = self
                .scenes
                .iter()
                .map(|scene| scene_row(system, scales, scene, &self.runs_of(scales, scene, system.name)))
                .collect();
            whole_row(system, scales, &rows, self.is_whole_set())
        };
        self.systems.iter().map(of_system).collect()
    }

    /// Returns true if the scenes are the eight of the papers' tables.
    pub fn is_whole_set(&self) -> bool {
        let all = trimip_data::BLENDER_SCENES;
        self.scenes.len() == all.len() && all.iter().all(|name| self.scenes.iter().any(|own| own == name))
    }

    /// Returns the runs that failed.
    pub fn failed(&self) -> impl Iterator<Item = (&Run, &str)> {
        self.runs.iter().filter_map(|run| match &run.status {
            Status::Failed(reason) => Some((run, reason.as_str())),
            _ => None,
        })
    }

    /// Returns the number of runs that are waiting or stopped.
    pub fn open(&self) -> usize {
        self.runs.iter().filter(|run| matches!(run.status, Status::Waiting | Status::Stopped)).count()
    }
}
