#![no_main]

trimip_fuzz::target!("archive");
