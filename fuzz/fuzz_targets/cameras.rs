#![no_main]

// `TRIMIP_FORMAT` is the kind of a registered file of cameras; see `trimip_data::in_memory::camera_files`.
trimip_fuzz::target!(&std::env::var("TRIMIP_FORMAT").expect("TRIMIP_FORMAT names a kind of file"));
