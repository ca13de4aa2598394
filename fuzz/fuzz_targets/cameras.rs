#![no_main]

// `TRIMIP_FORMAT` names a registered kind of camera file; see `trimip_data::in_memory::camera_files`.
trimip_fuzz::target!(&std::env::var("TRIMIP_FORMAT").expect("TRIMIP_FORMAT names a kind of file"));
