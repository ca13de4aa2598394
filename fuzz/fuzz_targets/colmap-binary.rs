#![no_main]

trimip_fuzz::target!("colmap-binary");
