#version 430
// Quads over the splats of one level: two triangles each, no attributes.
#include "surfels.glsl"
#include "shells.glsl"

layout(std430, binding = 0) readonly buffer Surfels { Surfel surfels[]; };
layout(std430, binding = 4) readonly buffer Splats { Splat splats[]; };
uniform vec2 target_size;
uniform int level;
uniform float inflation;
flat out uint v_surfel;
flat out vec4 v_place; // w: the square of the radius within which it is hit
flat out vec3 v_facing;

void main() {
    Splat splat = splats[gl_VertexID / 6];
    int corner = int[](0, 1, 2, 2, 1, 3)[gl_VertexID % 6];
    vec2 at = vec2((corner & 1) == 0 ? splat.rectangle.x : splat.rectangle.z,
                   (corner & 2) == 0 ? splat.rectangle.y : splat.rectangle.w);
    v_surfel = splat.surfel;
    // One of 4^l surfels stands for all of them.
    float radius = surfels[splat.surfel].place.w * inflation * float(1 << level);
    v_place = vec4(surfels[splat.surfel].place.xyz, radius * radius);
    v_facing = surfels[splat.surfel].facing.xyz;
    gl_Position = vec4(at / target_size * 2.0 - 1.0, 0.0, 1.0);
}
