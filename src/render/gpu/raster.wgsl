// The GPU's half of render::gpu::raster: coverage and the depth test by the fixed-function
// rasteriser, then one pass over the pixels that gives ids and depths.
//
// Corners come in snapped to 1/256 px, with 1/z (1/m) and an outcode: x, y, bits of 1/z, outcode.

struct View {
    width: u32,
    height: u32,
    num_mesh_triangles: u32,
    padding: u32,
}

@group(0) @binding(0) var<uniform> view: View;
// Three vertices to a triangle of the mesh.
@group(0) @binding(1) var<storage, read> triangles: array<u32>;
@group(0) @binding(2) var<storage, read> vertices: array<vec4<i32>>;
// Three corners to a piece of a clipped triangle; the first one's w is the triangle's id.
@group(0) @binding(3) var<storage, read> pieces: array<vec4<i32>>;

const NOTHING: u32 = 0xffffffffu;
// Masks of render::raster's outcodes: not drawn where all corners have a bit of the one, nor, as a
// whole, where any corner has one of the other.
override DROPPED_BY_ALL: i32;
override NOT_WHOLE_BY_ANY: i32;

struct Corners {
    a: vec4<i32>,
    b: vec4<i32>,
    c: vec4<i32>,
    is_drawn: bool,
}

// Triangles of the mesh first, then the pieces.
fn corners_of(slot: u32) -> Corners {
    if slot < view.num_mesh_triangles {
        let a = vertices[triangles[3u * slot]];
        let b = vertices[triangles[3u * slot + 1u]];
        let c = vertices[triangles[3u * slot + 2u]];
        let is_drawn = (a.w & b.w & c.w & DROPPED_BY_ALL) == 0
            && ((a.w | b.w | c.w) & NOT_WHOLE_BY_ANY) == 0;
        return Corners(a, b, c, is_drawn);
    }
    let first = 3u * (slot - view.num_mesh_triangles);
    return Corners(pieces[first], pieces[first + 1u], pieces[first + 2u], true);
}

fn is_before(p: vec4<i32>, q: vec4<i32>) -> bool {
    return p.y < q.y || (p.y == q.y && p.x < q.x);
}

struct Covered {
    @builtin(position) position: vec4<f32>,
    @location(0) @interpolate(flat, either) slot: u32,
}

@vertex
fn cover(@builtin(vertex_index) index: u32) -> Covered {
    let slot = index / 3u;
    let corners = corners_of(slot);
    // Triangles with the same corners must get the same depth to the last bit, in whatever order
    // their corners are listed, so that the first drawn one, of the lowest id, is kept.
    var a = corners.a;
    var b = corners.b;
    var c = corners.c;
    if is_before(b, a) { let t = a; a = b; b = t; }
    if is_before(c, b) { let t = b; b = c; c = t; }
    if is_before(b, a) { let t = a; a = b; b = t; }
    let which = index % 3u;
    let corner = select(select(a, b, which == 1u), c, which == 2u);
    if !corners.is_drawn {
        return Covered(vec4<f32>(2.0, 2.0, 0.5, 1.0), slot);
    }
    // Pixel centres are at integers here, at halves in the framebuffer. 1/z is affine in the
    // image, so that w is 1; it is at most 100, and 2^-7 of it is a depth between 0 and 1.
    let half_size_px = 0.5 * vec2<f32>(f32(view.width), f32(view.height));
    let px = (vec2<f32>(corner.xy) + 128.0) / 256.0;
    let ndc = px / half_size_px - 1.0;
    let inv_z = bitcast<f32>(corner.z);
    return Covered(vec4<f32>(ndc.x, -ndc.y, inv_z * 0.0078125, 1.0), slot);
}

@fragment
fn mark(covered: Covered) -> @location(0) u32 {
    return covered.slot;
}

@group(1) @binding(0) var slots: texture_2d<u32>;
@group(1) @binding(1) var<storage, read_write> triangle_out: array<u32>;
@group(1) @binding(2) var<storage, read_write> depth_out: array<f32>;

struct Wide {
    high: u32,
    low: u32,
}

// The exact product of two magnitudes.
fn multiply(a: u32, b: u32) -> Wide {
    let a0 = a & 0xffffu;
    let a1 = a >> 16u;
    let b0 = b & 0xffffu;
    let b1 = b >> 16u;
    let low = a0 * b0;
    let middle = a1 * b0 + (low >> 16u);
    let middle2 = a0 * b1 + (middle & 0xffffu);
    return Wide(a1 * b1 + (middle >> 16u) + (middle2 >> 16u), (middle2 << 16u) | (low & 0xffffu));
}

fn negate(a: Wide) -> Wide {
    return Wide(~a.high + select(0u, 1u, a.low == 0u), ~a.low + 1u);
}

fn signed_product(a: i32, b: i32) -> Wide {
    let magnitude = multiply(u32(abs(a)), u32(abs(b)));
    if (a < 0) != (b < 0) {
        return negate(magnitude);
    }
    return magnitude;
}

// p x q, exact in 64 bits, then rounded.
fn cross(p: vec2<i32>, q: vec2<i32>) -> f32 {
    let plus = signed_product(p.x, q.y);
    let minus = negate(signed_product(p.y, q.x));
    let low = plus.low + minus.low;
    var sum = Wide(plus.high + minus.high + select(0u, 1u, low < plus.low), low);
    let is_negative = (sum.high & 0x80000000u) != 0u;
    if is_negative {
        sum = negate(sum);
    }
    let magnitude = f32(sum.high) * 4294967296.0 + f32(sum.low);
    return select(magnitude, -magnitude, is_negative);
}

@compute @workgroup_size(8, 8)
fn resolve(@builtin(global_invocation_id) pixel: vec3<u32>) {
    if pixel.x >= view.width || pixel.y >= view.height {
        return;
    }
    let index = pixel.y * view.width + pixel.x;
    let slot = textureLoad(slots, pixel.xy, 0).x;
    if slot == NOTHING {
        triangle_out[index] = NOTHING;
        depth_out[index] = 0.0;
        return;
    }
    let corners = corners_of(slot);
    let here = vec2<i32>(pixel.xy) * 256;
    let a = corners.a.xy - here;
    let b = corners.b.xy - here;
    let c = corners.c.xy - here;
    let inv_z = vec3<f32>(bitcast<f32>(corners.a.z), bitcast<f32>(corners.b.z), bitcast<f32>(corners.c.z));
    // All of one sign within the triangle, or zero.
    let weights = vec3<f32>(cross(b, c), cross(c, a), cross(a, b));
    let area = cross(b - a, c - a);
    let nearest = max(max(inv_z.x, inv_z.y), inv_z.z);
    let farthest = min(min(inv_z.x, inv_z.y), inv_z.z);
    // A driver of a finer grid may draw what has no area on ours.
    var here_inv_z = nearest;
    if area != 0.0 {
        here_inv_z = clamp(dot(weights, inv_z) / area, farthest, nearest);
    }
    triangle_out[index] = select(u32(corners.a.w), slot, slot < view.num_mesh_triangles);
    depth_out[index] = 1.0 / here_inv_z;
}
