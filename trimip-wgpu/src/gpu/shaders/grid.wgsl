// Returns the index of an invocation. Workgroups are laid out in rows of at most 65,535.
fn index_of(group: vec3<u32>, groups: vec3<u32>, local: u32) -> u32 {
    return (group.y * groups.x + group.x) * GROUP + local;
}
