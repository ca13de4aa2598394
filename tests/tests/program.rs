//! Tests that start the program as its users do. They form one binary, which is linked once and whose tests share the cores.

mod binary;
mod binary_gpu;
mod broken_input;
mod captures;
mod check;
mod crop;
mod depths;
mod export;
mod faults;
mod first_hour;
mod inspect;
mod kills;
mod limits;
mod motion;
mod others;
mod pages;
mod paper;
mod ranks;
mod run_folder;
mod scene_plan;
mod signals;
mod view;
mod view_crop;
mod viewer_example;
mod web;
