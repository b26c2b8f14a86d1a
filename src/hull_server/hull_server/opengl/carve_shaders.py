"""GLSL 4.3 sources of the compute carve: five kernels, each of which hands the next one a list of what is undecided.

COARSE classifies blocks of 32^3 voxels, BRICKS of 8^3, BLOCKS of 4^3, by summed areas of the foreground; VOXELS tests
single voxels in the blocks that no box could settle; RECHECK repeats in double precision those that are uncertain in
single. A list is an array with the size of the next, indirect dispatch and its own length; its order is whatever the
device made it. Kernels never branch around expensive work where a list will do: software renderers execute both sides
of a branch, and the lanes of a GPU wait for one another.
"""

from __future__ import annotations

# voxel (i, j, k) to its pixel in double precision; false when it is not in front of the camera or not on the canvas
PROJECT_EXACTLY = """
layout(std430, binding = 0) readonly buffer Exact { dvec4 exact_projection[]; };   // 3 rows a camera, of (i, j, k, 1)
bool project_exactly(int camera, ivec3 voxel, out ivec2 pixel) {
    dvec4 at = dvec4(voxel, 1.0);
    double w = dot(exact_projection[3 * camera + 2], at);
    if (!(w > 0.0)) return false;
    dvec2 p = dvec2(dot(exact_projection[3 * camera], at), dot(exact_projection[3 * camera + 1], at)) / w;
    if (!(p.x >= 0.0 && p.y >= 0.0 && p.x < WIDTH && p.y < HEIGHT)) return false;
    pixel = ivec2(p);
    return true;
}
"""

# sizes and buffers: eight, the most that every OpenGL 4.3 driver has to offer
HEADER = """#version 430
#define CAMERAS {cameras}
#define WIDTH {width}
#define HEIGHT {height}
const ivec3 GRID = ivec3{grid}, BRICKS = ivec3{bricks}, COARSE = ivec3{coarse};   // voxels; blocks of 8^3, of 32^3
const int BRICK_COUNT = BRICKS.x * BRICKS.y * BRICKS.z, COARSE_BLOCKS = COARSE.x * COARSE.y * COARSE.z;
const ivec3 CENTRE = ivec3{centre};                       // the origin of single precision: a voxel,
const vec2 HALF_CANVAS = vec2(WIDTH, HEIGHT) * 0.5;      // and a pixel
const float BORDER_PX_M = {border};                      // its largest error in pixels, times depth
const float NEAR_M = 0.05;                               // a block that comes nearer has the whole canvas as its box
const uint GROUPS_IN_ROW = {groups}u;                    // of a dispatch; more make more rows
const uint UNSEEN = 0u, SEEN = 1u, PARTLY_SEEN = 2u;      // a camera sees none, all, perhaps some of a block's voxels
struct Brick {{ uint index, undecided, partly_blind; int settled; uint leaf[16]; }};
struct Block {{ uint place, undecided; uint uncertain[2]; }};  // place: 8 * brick's slot + octant, settled << 26
layout(std430, binding = 1) readonly buffer Boxes {{ uvec2 box[]; }};  // camera by camera: coarse blocks; then bricks
layout(std430, binding = 2) buffer Lists {{ uvec4 list[4]; }};                     // groups x, y, z; length
layout(std430, binding = 3) readonly buffer Frame {{
    uint present;                                // bit c: camera c is in this frame set
    int min_seeing;
    ivec2 unused;
    ivec4 foreground_box[CAMERAS];               // u, v from and to
    int area_start[CAMERAS];                     // word of the frame where a camera's summed areas begin
}};
layout(std430, binding = 4) buffer Coarse {{ uvec4 coarse[]; }};                   // block; undecided; settled
layout(std430, binding = 5) buffer Bricks {{ Brick brick[]; }};
layout(std430, binding = 6) buffer Blocks {{ Block block[]; }};
layout(std430, binding = 7) buffer Recheck {{ uint recheck[]; }};                  // 2 * block's slot + half
uniform isamplerBuffer frame;                    // the same words as a texture: labels, then summed areas
uniform vec4 projection[3 * CAMERAS];            // 3 rows a camera, from CENTRE to pixels from HALF_CANVAS
uint label_word(int camera, ivec2 pixel) {{      // 16 pixels a word: bit p foreground, 16 + p blind or uncertain
    int word = (camera * HEIGHT + pixel.y) * (WIDTH / 16) + (pixel.x >> 4);
    return uint(texelFetch(frame, {labels} + word).r) >> (pixel.x & 15);
}}
ivec3 corner_of(uint brick_index) {{              // its lowest voxel
    int b = int(brick_index);
    return 8 * ivec3(b % BRICKS.x, b / BRICKS.x % BRICKS.y, b / (BRICKS.x * BRICKS.y));
}}
ivec3 octant_of(uint place) {{ return ivec3(place & 1u, place >> 1 & 1u, place >> 2 & 1u); }}
uint append(int which, uint per_group) {{         // take the next place of a list, and see to it that it is worked on
    uint slot = atomicAdd(list[which].w, 1u), group = slot / per_group;
    atomicMax(list[which].x, min(group + 1u, GROUPS_IN_ROW));
    if (group >= GROUPS_IN_ROW) atomicMax(list[which].y, group / GROUPS_IN_ROW + 1u);
    return slot;
}}
uint group_number() {{ return gl_WorkGroupID.y * GROUPS_IN_ROW + gl_WorkGroupID.x; }}
uint invocation() {{ return group_number() * 64u + gl_LocalInvocationID.x; }}
"""

# what a camera sees of a block of voxels, from the pixel box on which they all lie
CLASSIFY = """
struct State { uint undecided, partly_blind; int settled, possible; bool empty; };
int foreground_in(int camera, ivec4 pixels) {      // two a foreground pixel, one an uncertain one
    ivec4 inside = foreground_box[camera];
    ivec2 low = max(pixels.xy, inside.xy) - inside.xy, high = min(pixels.zw, inside.zw) - inside.xy;
    if (any(greaterThanEqual(low, high))) return 0;
    int stride = inside.z - inside.x + 1, start = area_start[camera];
    int top = start + low.y * stride, bottom = start + high.y * stride;
    return texelFetch(frame, bottom + high.x).r - texelFetch(frame, top + high.x).r
         - texelFetch(frame, bottom + low.x).r + texelFetch(frame, top + low.x).r;
}
void classify(int camera, ivec4 pixels, uint visibility, inout State state) {
    uint bit = 1u << camera;
    int filled = foreground_in(camera, pixels);
    bool all_foreground = visibility == SEEN && filled == 2 * (pixels.z - pixels.x) * (pixels.w - pixels.y);
    state.empty = state.empty || (visibility == SEEN && filled == 0);
    state.possible += filled > 0 ? 1 : 0;
    state.settled += all_foreground ? 1 : 0;
    if (all_foreground || visibility == UNSEEN) state.undecided &= ~bit;
    if (visibility != SEEN) state.partly_blind |= bit;
}
void classify_packed(int camera, uvec2 b, inout State state) {      // 15 bits a coordinate, 2 bits of visibility
    classify(camera, ivec4(b.x & 0x7fffu, b.x >> 15 & 0x7fffu, b.y & 0x7fffu, b.y >> 15), b.x >> 30, state);
}
"""

COARSE = """
layout(local_size_x = 64) in;
void main() {
    uint block = gl_GlobalInvocationID.x;
    if (block >= uint(COARSE_BLOCKS)) return;
    State state = State(present, 0u, 0, 0, false);
    for (uint left = present; left != 0u && !state.empty; left &= left - 1u) {
        int camera = findLSB(left);
        classify_packed(camera, box[camera * COARSE_BLOCKS + int(block)], state);
    }
    if (state.empty || state.possible < min_seeing) return;
    uint slot = append(0, 1u);
    coarse[slot] = uvec4(block, state.undecided, state.settled, 0u);
}
"""

# a group is a coarse block, an invocation one of its 64 bricks
BRICKS = """
layout(local_size_x = 64) in;
void main() {
    if (group_number() >= list[0].w) return;
    uvec4 from = coarse[group_number()];
    int c = int(from.x), b = int(gl_LocalInvocationID.x);
    ivec3 at = 4 * ivec3(c % COARSE.x, c / COARSE.x % COARSE.y, c / (COARSE.x * COARSE.y));
    at += ivec3(b & 3, b >> 2 & 3, b >> 4);
    if (any(greaterThanEqual(at, BRICKS))) return;
    uint index = uint((at.z * BRICKS.y + at.y) * BRICKS.x + at.x);
    State state = State(from.y, 0u, int(from.z), int(from.z), false);
    for (uint left = from.y; left != 0u && !state.empty; left &= left - 1u) {
        int camera = findLSB(left);
        classify_packed(camera, box[CAMERAS * COARSE_BLOCKS + camera * BRICK_COUNT + int(index)], state);
    }
    if (state.empty || state.possible < min_seeing) return;
    uint slot = append(1, 8u);
    brick[slot].index = index;
    brick[slot].undecided = state.undecided;
    brick[slot].partly_blind = state.partly_blind;
    brick[slot].settled = state.settled;
    for (int word = 0; word < 16; word++) brick[slot].leaf[word] = 0u;
}
"""

# 8 bricks a group, an invocation is a block of 4^3 voxels: an octant of its brick. Its pixel boxes are computed here
BLOCKS = """
layout(local_size_x = 64) in;
ivec4 project_box(int camera, ivec3 low, vec3 size) {
    vec4 a = projection[3 * camera], b = projection[3 * camera + 1], c = projection[3 * camera + 2];
    vec4 from = vec4(low - CENTRE, 1.0);
    vec3 at = vec3(dot(a, from), dot(b, from), dot(c, from));
    vec3 dx = size.x * vec3(a.x, b.x, c.x), dy = size.y * vec3(a.y, b.y, c.y), dz = size.z * vec3(a.z, b.z, c.z);
    vec2 least = vec2(1e30), most = vec2(-1e30);
    float nearest = 1e30;
    for (int corner = 0; corner < 8; corner++) {
        vec3 p = at + float(corner & 1) * dx + float(corner >> 1 & 1) * dy + float(corner >> 2) * dz;
        nearest = min(nearest, p.z);
        p.xy *= 1.0 / p.z;
        least = min(least, p.xy);
        most = max(most, p.xy);
    }
    vec2 canvas = vec2(WIDTH, HEIGHT);
    if (nearest < NEAR_M) return ivec4(0, 0, canvas);
    least += HALF_CANVAS - BORDER_PX_M / nearest;
    most += HALF_CANVAS + BORDER_PX_M / nearest + 1.0;
    return ivec4(clamp(least, vec2(0.0), canvas), clamp(most, vec2(0.0), canvas));
}
void fill(uint slot, ivec3 octant, ivec3 size) {       // all voxels of the block, as far as the grid reaches
    uint row = ((1u << size.x) - 1u) << (4 * octant.x), rows = 0u;
    for (int y = 0; y < size.y; y++) rows |= row << (8 * y);
    for (int z = 0; z < size.z; z++) atomicOr(brick[slot].leaf[2 * (4 * octant.z + z) + octant.y], rows);
}
void main() {
    uint place = invocation(), slot = place >> 3;
    if (slot >= list[1].w) return;
    ivec3 octant = octant_of(place), low = corner_of(brick[slot].index) + 4 * octant;
    ivec3 size = min(ivec3(4), GRID - low);
    if (any(lessThanEqual(size, ivec3(0)))) return;
    uint partly_blind = brick[slot].partly_blind;      // what a camera sees whole of the brick, it sees whole here
    int settled = brick[slot].settled;
    State state = State(brick[slot].undecided, 0u, settled, settled, false);
    for (uint left = state.undecided; left != 0u && !state.empty; left &= left - 1u) {
        int camera = findLSB(left);
        ivec4 pixels = project_box(camera, low, vec3(size - 1));
        bool on_canvas = pixels.x < pixels.z && pixels.y < pixels.w;
        uint visibility = (partly_blind >> camera & 1u) == 0u ? SEEN : on_canvas ? PARTLY_SEEN : UNSEEN;
        classify(camera, pixels, visibility, state);
    }
    if (state.empty || state.possible < min_seeing) return;
    if (state.undecided == 0u) {
        fill(slot, octant, size);
        return;
    }
    uint found = append(2, 8u);
    block[found].place = place | uint(state.settled) << 26;
    block[found].undecided = state.undecided;
    block[found].uncertain[0] = block[found].uncertain[1] = 0u;
}
"""

# 8 blocks a group, an invocation is two rows of 4 voxels. Bit 16 z + 4 y + x of a block is bit i of lane 2 z + y / 2
VOXELS = """
layout(local_size_x = 64) in;
uint spread(uint row) { return row * 0x00204081u & 0x01010101u; }              // 4 bits to 4 bytes
uint gather(uint flags) { return (flags >> 7 & 0x01010101u) * 0x01020408u >> 24; }  // the top bits of 4 bytes
void main() {
    uint found = invocation() >> 3, lane = invocation() & 7u;
    if (found >= list[2].w) return;
    uint place = block[found].place & 0x3ffffffu, slot = place >> 3;
    int settled = int(block[found].place >> 26);
    ivec3 octant = octant_of(place);
    ivec3 first = corner_of(brick[slot].index) + 4 * octant + ivec3(0, 2u * (lane & 1u), lane >> 1);
    ivec3 size = clamp(GRID - first, ivec3(0), ivec3(4, 2, 1));
    uint row = size.z > 0 ? (1u << size.x) - 1u : 0u;
    uint candidates = size.y == 2 ? row | row << 4 : size.y == 1 ? row : 0u, uncertain = 0u;
    uvec2 seeing = uvec2(0u);                                                  // a byte a voxel
    for (uint left = block[found].undecided; left != 0u && candidates != 0u; left &= left - 1u) {
        int camera = findLSB(left);
        vec4 r0 = projection[3 * camera], r1 = projection[3 * camera + 1], r2 = projection[3 * camera + 2];
        vec4 at = vec4(first - CENTRE, 1.0);
        vec3 p = vec3(dot(r0, at), dot(r1, at), dot(r2, at)), dx = vec3(r0.x, r1.x, r2.x);
        vec3 dy = vec3(r0.y, r1.y, r2.y);
        uint foreground = 0u, blind = 0u, near_border = 0u;
        for (int i = 0; i < 8; i++) {
            vec3 q = p + float(i & 3) * dx + float(i >> 2) * dy;
            vec2 uv = q.xy * (1.0 / q.z) + HALF_CANVAS, beyond = abs(uv - round(uv));
            bool on_canvas = q.z > 0.0 && uv.x > 0.0 && uv.y > 0.0 && uv.x < float(WIDTH) && uv.y < float(HEIGHT);
            ivec2 pixel = on_canvas ? ivec2(uv) : ivec2(0);
            uint word = on_canvas ? label_word(camera, pixel) : 0x10000u;
            foreground |= (word & 1u) << i;
            blind |= (word >> 16 & 1u) << i;
            near_border |= min(beyond.x, beyond.y) * abs(q.z) < BORDER_PX_M ? 1u << i : 0u;
        }
        candidates &= foreground | blind | near_border;
        uncertain |= near_border;
        seeing += uvec2(spread(foreground & 15u), spread(foreground >> 4));
    }
    uncertain &= candidates;
    uint enough = uint(128 - max(min_seeing - settled, 0)) * 0x01010101u;
    uint occupied = candidates & ~uncertain & (gather(seeing.x + enough) | gather(seeing.y + enough) << 4);
    if (uncertain != 0u && atomicOr(block[found].uncertain[lane >> 2], uncertain << (8u * (lane & 3u))) == 0u) {
        uint half_block = append(3, 64u);
        recheck[half_block] = 2u * found + (lane >> 2);
    }
    if (occupied != 0u)
        atomicOr(brick[slot].leaf[2 * (4 * octant.z + int(lane >> 1)) + octant.y],
                 ((occupied & 15u) | occupied >> 4 << 8) << (16u * (lane & 1u) + 4u * uint(octant.x)));
}
"""

# the voxels that are uncertain in single precision; an invocation takes those of half a block, one after the other
RECHECK = """
layout(local_size_x = 64) in;
bool occupied(ivec3 voxel, uint cameras, int settled) {
    int seeing = settled;
    for (uint left = cameras; left != 0u; left &= left - 1u) {
        int camera = findLSB(left);
        ivec2 pixel;
        if (!project_exactly(camera, voxel, pixel)) continue;
        uint word = label_word(camera, pixel);
        if ((word & 0x10001u) == 0u) return false;
        seeing += int(word & 1u);
    }
    return seeing >= min_seeing;
}
void main() {
    if (invocation() >= list[3].w) return;
    uint half_block = recheck[invocation()], found = half_block >> 1;
    uint place = block[found].place & 0x3ffffffu, slot = place >> 3;
    int settled = int(block[found].place >> 26);
    ivec3 octant = octant_of(place), corner = corner_of(brick[slot].index);
    for (uint left = block[found].uncertain[half_block & 1u]; left != 0u; left &= left - 1u) {
        int bit = findLSB(left) + 32 * int(half_block & 1u);
        ivec3 in_brick = 4 * octant + ivec3(bit & 3, bit >> 2 & 3, bit >> 4);
        if (occupied(corner + in_brick, block[found].undecided, settled))
            atomicOr(brick[slot].leaf[2 * in_brick.z + octant.y], 1u << (8 * (in_brick.y & 3) + in_brick.x));
    }
}
"""

KERNELS = {
    "coarse": CLASSIFY + COARSE,
    "bricks": CLASSIFY + BRICKS,
    "blocks": CLASSIFY + BLOCKS,
    "voxels": VOXELS,
    "recheck": PROJECT_EXACTLY + RECHECK,
}
