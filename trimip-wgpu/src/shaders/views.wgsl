// The training views, or the view to be rendered.

@group(0) @binding(0) var<storage, read> views: array<View>;
