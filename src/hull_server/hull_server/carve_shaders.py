"""GLSL 4.3 sources of the compute carve. Images are bit-packed: bit u % 32 of word u / 32 of a row.

Single precision places a voxel to about a thousandth of a pixel. Where that could decide between two pixels, or
between the front and the back of a camera, the projection is done again in double precision.
"""

# voxel (i, j, k) to its pixel; false when it is not in front of the camera or not on the canvas
PROJECT = """
layout(std430, binding = 2) readonly buffer Projections { vec4 projection[]; };    // 3 rows a camera, of (i, j, k, 1)
layout(std430, binding = 7) readonly buffer Exact { dvec4 exact_projection[]; };
const float BORDER_PX_M = 2e-6 * float(max(WIDTH, HEIGHT)), NEAR_M = 0.3;          // several times the rounding
bool project_exactly(int camera, ivec3 voxel, out ivec2 pixel) {
    dvec4 at = dvec4(voxel, 1.0);
    double w = dot(exact_projection[3 * camera + 2], at);
    if (!(w > 0.0)) return false;
    dvec2 p = dvec2(dot(exact_projection[3 * camera], at), dot(exact_projection[3 * camera + 1], at)) / w;
    if (!(p.x >= 0.0 && p.y >= 0.0 && p.x < WIDTH && p.y < HEIGHT)) return false;
    pixel = ivec2(p);
    return true;
}
bool project(int camera, ivec3 voxel, out ivec2 pixel) {
    vec4 at = vec4(voxel, 1.0);
    float w = dot(projection[3 * camera + 2], at);
    if (w < -NEAR_M) return false;
    vec2 p = vec2(dot(projection[3 * camera], at), dot(projection[3 * camera + 1], at)) / w;
    vec2 beyond = abs(p - round(p));                  // distance from the nearest border between pixels
    if (w < NEAR_M || min(beyond.x, beyond.y) * min(w, 1.0) < BORDER_PX_M) return project_exactly(camera, voxel, pixel);
    if (!(all(greaterThan(p, vec2(0.0))) && p.x < WIDTH && p.y < HEIGHT)) return false;
    pixel = ivec2(p);
    return true;
}
"""

HEADER = """#version 430
#define CAMERAS {cameras}
#define WIDTH {width}
#define HEIGHT {height}
#define TILES_X {tiles_x}
#define TILES_Y {tiles_y}
#define TILE {tile}
layout(std430, binding = 0) readonly buffer Foreground {{ uint foreground[]; }};   // seen foreground
layout(std430, binding = 1) readonly buffer Seen {{ uint seen[]; }};
layout(std430, binding = 3) buffer Tiles {{ uint tile[]; }};                       // 1: some foreground
layout(std430, binding = 4) readonly buffer Boxes {{ uvec2 box[]; }};              // per brick and camera
layout(std430, binding = 5) buffer Bricks {{ uint groups_x, groups_y, groups_z, count; uint brick[]; }};
layout(std430, binding = 6) writeonly buffer Leaves {{ uint leaf[]; }};            // 16 words a brick
uniform uint present;      // bit c: camera c is in this frame set
uniform int min_seeing;
uniform ivec3 grid;        // voxels
uniform ivec3 bricks;      // bricks of 8 voxels
"""

# which tiles of an image hold any foreground
TILES = """
layout(local_size_x = 8, local_size_y = 8) in;
void main() {
    ivec3 t = ivec3(gl_GlobalInvocationID);              // tile u, tile v, camera
    if (t.x >= TILES_X || t.y >= TILES_Y) return;
    uint any_bit = 0u;
    for (int v = t.y * TILE; v < min(t.y * TILE + TILE, HEIGHT); v++) {
        uint word = foreground[(t.z * HEIGHT + v) * (WIDTH / 32) + (t.x * TILE) / 32];
        any_bit |= bitfieldExtract(word, (t.x * TILE) % 32, TILE);
    }
    tile[(t.z * TILES_Y + t.y) * TILES_X + t.x] = any_bit != 0u ? 1u : 0u;
}
"""

# the bricks that may hold an occupied voxel, appended in any order
BRICKS = """
layout(local_size_x = 64) in;
bool any_foreground(int camera, uvec2 b) {
    uint u1 = bitfieldExtract(b.x, 12, 12), v1 = bitfieldExtract(b.y, 12, 12);
    for (uint v = b.y & 0xfffu; v <= v1; v++)
        for (uint u = b.x & 0xfffu; u <= u1; u++)
            if (tile[(uint(camera) * TILES_Y + v) * TILES_X + u] != 0u) return true;
    return false;
}
void main() {
    uint b = gl_GlobalInvocationID.x;
    if (b >= uint(bricks.x * bricks.y * bricks.z)) return;
    int possible = 0;
    for (int camera = 0; camera < CAMERAS; camera++) {
        uvec2 pixels = box[b * uint(CAMERAS) + uint(camera)];
        uint sight = pixels.x >> 24;                     // 0 sees none of the voxels, 1 all, 2 perhaps some
        if ((present >> camera & 1u) == 0u || sight == 0u) continue;
        if (any_foreground(camera, pixels)) possible++;
        else if (sight == 1u) return;                    // seen whole, and all of it background
    }
    if (possible < min_seeing) return;
    uint slot = atomicAdd(count, 1u);
    brick[slot] = b;
    atomicMax(groups_x, slot + 1u);
}
"""

# the rule, voxel by voxel, in the surviving bricks: an invocation makes one word, 4 rows of 8 voxels
LEAVES = """
layout(local_size_x = 16) in;
void main() {
    int b = int(brick[gl_WorkGroupID.x]), word = int(gl_LocalInvocationID.x);
    ivec3 corner = 8 * ivec3(b % bricks.x, (b / bricks.x) % bricks.y, b / (bricks.x * bricks.y));
    uint occupied = 0u;
    for (int bit = 0; bit < 32; bit++) {
        ivec3 voxel = corner + ivec3(bit % 8, (word % 2) * 4 + bit / 8, word / 2);
        if (any(greaterThanEqual(voxel, grid))) continue;
        int seeing = 0;
        bool vetoed = false;
        for (int camera = 0; camera < CAMERAS && !vetoed; camera++) {
            if ((present >> camera & 1u) == 0u) continue;
            ivec2 p;
            if (!project(camera, voxel, p)) continue;
            int index = (camera * HEIGHT + p.y) * (WIDTH / 32) + p.x / 32;
            uint mask = 1u << (p.x % 32);
            if ((seen[index] & mask) == 0u) continue;
            if ((foreground[index] & mask) != 0u) seeing++;
            else vetoed = true;
        }
        if (!vetoed && seeing >= min_seeing) occupied |= 1u << bit;
    }
    leaf[16 * gl_WorkGroupID.x + uint(word)] = occupied;
}
"""
