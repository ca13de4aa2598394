// Which invocation this is, when work is laid out in rows of workgroups: a row has at most 65,535 of them.
fn index_of(group: vec3<u32>, groups: vec3<u32>, local: u32) -> u32 {
    return (group.y * groups.x + group.x) * GROUP + local;
}
