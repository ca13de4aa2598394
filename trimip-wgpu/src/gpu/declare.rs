//! Macros with which a stage declares the structs that it shares with WGSL, and its kernels.

/// Defines structs that Rust and WGSL share, with the syntax `struct NAME as NAME_IN_WGSL`.
macro_rules! shared {
    ($($(#[$about:meta])* $vis:vis struct $name:ident as $wgsl:ident {
        $($(#[$doc:meta])* $seen:vis $field:ident: $kind:ty),* $(,)?
    })+) => {$(
        $(#[$about])*
        #[repr(C)]
        #[derive(Clone, Copy, Debug, Default, bytemuck::Pod, bytemuck::Zeroable)]
        $vis struct $name {
            $($(#[$doc])* $seen $field: $kind),*
        }

        mirror!($name as $wgsl { $($field: $kind),* });
    )+};
}

/// Describes a struct of Rust to WGSL: all of its fields, with their types.
macro_rules! mirror {
    ($name:ty as $wgsl:ident { $($field:ident: $kind:ty),* $(,)? }) => {
        impl $crate::gpu::Wgsl for $name {
            const TYPE: &'static str = stringify!($wgsl);
        }

        impl $crate::gpu::Shared for $name {
            const LAYOUT: $crate::gpu::Layout = $crate::gpu::Layout {
                name: stringify!($wgsl),
                size: size_of::<$name>(),
                members: &[$($crate::gpu::Member {
                    name: stringify!($field),
                    kind: <$kind as $crate::gpu::Wgsl>::TYPE,
                    offset: std::mem::offset_of!($name, $field),
                }),*],
            };
        }

        // Checks that the described types are those of the fields.
        const _: fn(&$name) = |value| {
            $(let _: &$kind = &value.$field;)*
        };
    };
}

/// Declares the kernels of a stage: a struct of pipelines, one for each kernel.
macro_rules! kernels {
    ($(#[$about:meta])* $vis:vis struct $name:ident { $($(#[$doc:meta])* $field:ident: $kernel:expr),* $(,)? }) => {
        $(#[$about])*
        $vis struct $name {
            $($(#[$doc])* pub $field: $crate::gpu::Pipeline),*
        }

        impl $name {
            /// Finds the pipelines of a device.
            pub fn new(gpu: &$crate::gpu::Gpu) -> Self {
                Self { $($field: gpu.pipeline($kernel)),* }
            }

            /// Returns all kernels, for validation.
            #[cfg(test)]
            pub fn all() -> Vec<$crate::gpu::Kernel> {
                vec![$($kernel),*]
            }
        }
    };
}
