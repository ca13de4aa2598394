//! Checks with naga that all kernels, in every variant that a configuration can select, are valid, fit every device, use
//! the bindings that they list, and share their structs with Rust.

use crate::gpu::{Access, Kernel, Layout};
use crate::workspace::Addition;
use crate::{
    deferred, encoder, field, gpu, hybrid, losses, mlp, occupancy, optimizer, poses, products, renderer,
    sampler, workspace,
};
use naga::valid::{Capabilities, ModuleInfo, ValidationFlags, Validator};
use naga::{AddressSpace, Handle, Module, Scalar, ScalarKind, StorageAccess, Type, TypeInner};

/// Returns every kernel in every variant, or in a similar variant.
fn all() -> Vec<Kernel> {
    let stages = [
        gpu::all(),
        vec![workspace::gather(), optimizer::update()],
        encoder::kernels(),
        field::Kernels::all(),
        deferred::Kernels::all(),
        hybrid::Kernels::all(),
        losses::all(),
        mlp::Kernels::all(),
        occupancy::Kernels::all(),
        poses::Kernels::all(),
        products::all(),
        renderer::Kernels::all(),
        sampler::Kernels::all(),
    ];
    stages.concat()
}

fn parse(kernel: &Kernel) -> Module {
    naga::front::wgsl::parse_str(&kernel.source())
        .unwrap_or_else(|error| panic!("{}: {}", kernel.name(), error.emit_to_string(&kernel.source())))
}

/// Validates a kernel. Capabilities beyond the default are allowed only to kernels that run only on adapters with these
/// capabilities.
fn validate(kernel: &Kernel, module: &Module) -> ModuleInfo {
    let capabilities = if kernel.has(Addition::Atomic.source()) {
        Capabilities::SHADER_FLOAT32_ATOMIC
    } else if kernel.is_cooperative() {
        Capabilities::SHADER_FLOAT16 | Capabilities::COOPERATIVE_MATRIX | Capabilities::SUBGROUP
    } else {
        Capabilities::default()
    };
    Validator::new(ValidationFlags::all(), capabilities)
        .validate(module)
        .unwrap_or_else(|error| panic!("{}: {}", kernel.name(), error.emit_to_string(&kernel.source())))
}

#[test]
fn every_variant_is_valid_and_fits_everywhere() {
    for kernel in all() {
        let name = kernel.name();
        let module = parse(&kernel);
        let info = validate(&kernel, &module);
        let place = module.entry_points.iter().position(|entry| entry.name == kernel.entry);
        let place = place.unwrap_or_else(|| panic!("{name}: no such entry point"));
        assert!(module.entry_points[place].workgroup_size[0] <= 256, "{name}");

        // Checks that the listed bindings are those that the entry point uses, with their declared access.
        let used = info.get_entry_point(place);
        let mut found: Vec<(u32, Access)> = Vec::new();
        let (mut storage, mut workgroup) = (0, 0);
        for (handle, variable) in module.global_variables.iter() {
            if used[handle].is_empty() {
                continue;
            }
            let size = module.types[variable.ty].inner.size(module.to_ctx());
            let access = match variable.space {
                AddressSpace::Uniform => Access::Parameters,
                AddressSpace::Storage { access } if access.contains(StorageAccess::STORE) => Access::Write,
                AddressSpace::Storage { .. } => Access::Read,
                AddressSpace::WorkGroup => {
                    workgroup += size;
                    continue;
                }
                _ => continue,
            };
            if access == Access::Parameters {
                assert!(size <= 512, "{name}: parameters of {size} bytes");
            } else {
                storage += 1;
            }
            found.extend(variable.binding.as_ref().map(|at| (at.binding, access)));
        }
        found.sort_by_key(|(binding, _)| *binding);
        assert_eq!(found, kernel.bindings(), "{name}");
        assert!(storage <= 8, "{name}: {storage} storage buffers");
        assert!(workgroup <= 20 << 10, "{name}: {workgroup} bytes of workgroup memory");
    }
}

/// Returns the name of a type as WGSL writes it.
fn text(module: &Module, handle: Handle<Type>) -> String {
    let scalar = |scalar: Scalar| match scalar {
        Scalar { kind: ScalarKind::Float, width: 4 } => "f32",
        Scalar { kind: ScalarKind::Uint, width: 4 } => "u32",
        other => panic!("{other:?} is not shared"),
    };
    let own = &module.types[handle];
    match &own.inner {
        TypeInner::Scalar(of) => scalar(*of).to_string(),
        TypeInner::Vector { size, scalar: of } => format!("vec{}<{}>", *size as u32, scalar(*of)),
        TypeInner::Array { base, size: naga::ArraySize::Constant(count), .. } => {
            format!("array<{}, {count}>", text(module, *base))
        }
        TypeInner::Struct { .. } => own.name.clone().unwrap_or_default(),
        other => panic!("{other:?} is not shared"),
    }
}

/// Compares a struct of a module with its layout in Rust. A struct in an array must also have the same stride, so its
/// size must be a multiple of its alignment.
fn compare(kernel: &Kernel, module: &Module, layout: &Layout) {
    let place = format!("{}: {}", kernel.name(), layout.name);
    let (handle, own) = module
        .types
        .iter()
        .find(|(_, own)| own.name.as_deref() == Some(layout.name))
        .unwrap_or_else(|| panic!("{place} is missing"));
    let TypeInner::Struct { members, span } = &own.inner else { panic!("{place} is no struct") };
    let found: Vec<(String, String, usize)> = members
        .iter()
        .map(|m| (m.name.clone().unwrap_or_default(), text(module, m.ty), m.offset as usize))
        .collect();
    let expected: Vec<(String, String, usize)> =
        layout.members.iter().map(|m| (m.name.into(), m.kind.into(), m.offset)).collect();
    assert_eq!(found, expected, "{place}");
    let mut layouter = naga::proc::Layouter::default();
    layouter.update(module.to_ctx()).expect("types have layouts");
    let alignment = layouter[handle].alignment;
    assert_eq!(*span, alignment.round_up(layout.size as u32), "{place}: size");
    let repeats = module.types.iter().any(|(_, other)| match &other.inner {
        TypeInner::Array { base, .. } => *base == handle,
        TypeInner::Struct { members, .. } => members.iter().any(|member| member.ty == handle),
        _ => false,
    });
    if repeats {
        assert_eq!(*span as usize, layout.size, "{place}: distance in an array");
    }
}

/// Structs in arrays that only the device reads and writes.
const ON_DEVICE: [&str; 1] = ["Gaussian"];

/// Checks that Rust and WGSL agree on the names, types and offsets of all members of every struct that they share, and
/// on the struct's size.
#[test]
fn shared_structs_have_one_layout() {
    let mut compared = std::collections::BTreeSet::new();
    for kernel in all() {
        let module = parse(&kernel);
        for layout in kernel.layouts() {
            compare(&kernel, &module, layout);
            compared.insert(layout.text());
        }
        // Structs of parameters, and of elements of arrays that the host writes, must be shared: none of them may be
        // defined only in WGSL.
        for (_, variable) in module.global_variables.iter() {
            let shared = match (&variable.space, &module.types[variable.ty].inner) {
                (AddressSpace::Uniform, TypeInner::Struct { .. }) => Some(variable.ty),
                (AddressSpace::Storage { .. }, TypeInner::Array { base, .. }) => {
                    matches!(module.types[*base].inner, TypeInner::Struct { .. }).then_some(*base)
                }
                _ => None,
            };
            let name = shared.and_then(|handle| module.types[handle].name.clone());
            if let Some(name) = name.filter(|name| !ON_DEVICE.contains(&name.as_str())) {
                assert!(kernel.layouts().any(|layout| layout.name == name), "{}: {name}", kernel.name());
            }
        }
    }
    assert!(compared.len() >= 29, "{} structs are shared", compared.len());
}

/// Checks that two members that are swapped in WGSL are detected.
#[test]
#[should_panic(expected = "size []: Params")]
fn swapped_members_are_found() {
    let kernel = gpu::all().remove(0);
    let layout = kernel.layouts().next().expect("it has parameters");
    let swapped = kernel.source().replace("counter: u32,\n    per: u32,", "per: u32,\n    counter: u32,");
    let module = naga::front::wgsl::parse_str(&swapped).expect("it is valid");
    compare(&kernel, &module, layout);
}
