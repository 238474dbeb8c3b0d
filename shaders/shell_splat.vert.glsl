#version 430
// Quads over the splats of one level: two triangles each, no attributes.
#include "surfels.glsl"
#include "shells.glsl"

layout(std430, binding = 0) readonly buffer Surfels { Surfel surfels[]; };
layout(std430, binding = 1) readonly buffer Radiances { vec4 radiances[]; }; // LAYERS a side
layout(std430, binding = 4) readonly buffer Splats { Splat splats[]; };
uniform vec2 target_size;
uniform int level;
uniform float epsilon;
uniform bool last; // the shell has no end
uniform int side; // 0: surfels send to the front; 1: to the back
flat out vec4 v_place;  // w: area
flat out vec3 v_facing;
flat out vec2 v_shell;  // squares of its radii
flat out vec4 v_radiance[LAYERS];

void main() {
    Splat splat = splats[gl_VertexID / 6];
    int corner = int[](0, 1, 2, 2, 1, 3)[gl_VertexID % 6];
    vec2 at = vec2((corner & 1) == 0 ? splat.rectangle.x : splat.rectangle.z,
                   (corner & 2) == 0 ? splat.rectangle.y : splat.rectangle.w);
    vec4 place = surfels[splat.surfel].place;
    // On level l a pixel meets one of 4^l surfels, which stands for all of them: its light is multiplied, where the papers
    // enlarge the disk, so that the mean over the sub-buffers is that of the surfels.
    float most = 0.0, wider = float(1 << (2 * level));
    for (int l = 0; l < LAYERS; ++l) {
        vec4 L = radiances[(splat.surfel * uint(SIDES) + uint(side)) * uint(LAYERS) + uint(l)];
        most = max(most, max(max(L.x, L.y), max(L.z, L.w)));
        v_radiance[l] = L * wider;
    }
    v_place = vec4(place.xyz, PI * place.w * place.w);
    v_facing = float(1 - 2 * side) * surfels[splat.surfel].facing.xyz;
    float outer = first_reach2(place.w, most, epsilon) * wider;
    v_shell = vec2(level == 0 ? 0.0 : 0.25 * outer, last ? max(outer, ACROSS2) : outer);
    gl_Position = vec4(at / target_size * 2.0 - 1.0, 0.0, 1.0);
}
