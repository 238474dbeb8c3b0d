#version 430
// Bounds of what each tile of the picture sees: one thread a tile.
layout(local_size_x = 64) in;
#include "receivers.glsl"
#include "tiles.glsl"

layout(std430, binding = 0) writeonly buffer Groups { Group groups[]; }; // two a tile
uniform ivec2 tiles;

const float APART = 0.7; // two groups are worth their while if together they reach less far than this share of one

// side: 0 below `divide` along `axis`, 1 above it; -1 all.
Group bounds(ivec2 corner, int side, int axis, float divide) {
    vec3 low = vec3(1e30), high = vec3(-1e30), sum = vec3(0.0), p, n;
    float count = 0.0;
    for (int k = 0; k < TILE * TILE; ++k) {
        ivec2 pixel = corner + ivec2(k % TILE, k / TILE);
        if (any(greaterThanEqual(pixel, picture_size())) || !find_receiver(pixel, p, n)) continue;
        if (side >= 0 && (p[axis] > divide) != (side == 1)) continue;
        low = min(low, p);
        high = max(high, p);
        sum += n;
        count += 1.0;
    }
    vec3 middle = 0.5 * (low + high), mean = dot(sum, sum) > 0.0 ? normalize(sum) : vec3(0.0, 0.0, 1.0);
    float radius = 0.0, cosine = 1.0, behind = 1e30;
    for (int k = 0; k < TILE * TILE; ++k) {
        ivec2 pixel = corner + ivec2(k % TILE, k / TILE);
        if (any(greaterThanEqual(pixel, picture_size())) || !find_receiver(pixel, p, n)) continue;
        if (side >= 0 && (p[axis] > divide) != (side == 1)) continue;
        radius = max(radius, distance(p, middle));
        cosine = min(cosine, dot(n, mean));
        behind = min(behind, dot(mean, p));
    }
    vec3 extent = high - low;
    int longest = extent.x >= extent.y && extent.x >= extent.z ? 0 : (extent.y >= extent.z ? 1 : 2);
    return Group(vec4(middle, radius), vec4(mean, cosine), behind, count, float(longest), middle[longest]);
}

void main() {
    int tile = int(gl_GlobalInvocationID.x);
    if (tile >= tiles.x * tiles.y) return;
    ivec2 corner = TILE * ivec2(tile % tiles.x, tile / tiles.x);
    Group all = bounds(corner, -1, 0, 0.0);
    Group none = Group(vec4(0.0), vec4(0.0), 0.0, 0.0, -1.0, 0.0);
    if (all.count > 0.0) {
        int axis = int(all.axis);
        Group near = bounds(corner, 0, axis, all.divide), far = bounds(corner, 1, axis, all.divide);
        if (near.count > 0.0 && far.count > 0.0 && near.sphere.w + far.sphere.w < APART * all.sphere.w) {
            near.axis = far.axis = all.axis;
            near.divide = far.divide = all.divide;
            groups[2 * tile] = near;
            groups[2 * tile + 1] = far;
            return;
        }
    }
    all.axis = -1.0;
    groups[2 * tile] = all;
    groups[2 * tile + 1] = none;
}
