#version 430
// One drawable's triangles, in the coordinates of the surfels.
layout(local_size_x = 64) in;
#include "items.glsl"
#include "surfels.glsl"

layout(std430, binding = 0) readonly buffer Positions { float positions[]; }; // three a vertex
layout(std430, binding = 1) readonly buffer AtlasUv { float atlas_uv[]; };    // two a vertex
layout(std430, binding = 2) readonly buffer Indices { uint indices[]; };
layout(std430, binding = 3) writeonly buffer Triangles { Triangle triangles[]; };
uniform mat4 to_surfels;
uniform float number;
uniform float handedness;
uniform vec2 atlas_size;
uniform float largest; // radius of a surfel
uniform int first;
uniform int count;

vec3 corner(uint v) {
    return (to_surfels * vec4(positions[3u * v], positions[3u * v + 1u], positions[3u * v + 2u], 1.0)).xyz;
}

vec2 coordinate(uint v) {
    return vec2(atlas_uv[2u * v], atlas_uv[2u * v + 1u]);
}

void main() {
    int k = int(item_number());
    if (k >= count) return;
    uvec3 v = uvec3(indices[3 * k], indices[3 * k + 1], indices[3 * k + 2]);
    vec3 a = corner(v.x), b = corner(v.y), c = corner(v.z);
    vec2 p = coordinate(v.x), q = coordinate(v.y), r = coordinate(v.z);
    float area = 0.5 * length(cross(b - a, c - a));
    vec2 u = (q - p) * atlas_size, w = (r - p) * atlas_size;
    float texels = 0.5 * abs(u.x * w.y - u.y * w.x);
    Triangle t;
    t.a = vec4(a, number);
    t.b = vec4(b, area);
    t.c = vec4(c, texels > 0.0 && area > 0.0 ? 0.5 * log2(texels / area) : 0.0);
    t.uv = vec4(p, q);
    t.more = vec4(r, handedness, largest);
    triangles[first + k] = t;
}
