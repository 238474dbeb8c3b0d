#version 430
// Chooses, for each group of a tile, the cells that stand for all that glows as seen from there, and what each promises:
// one thread a group. The walk goes down where a cell looks too large, and passes over what lies behind all receivers.
// Run twice: once to count, once, with FILL, to write where the count has made room; each time in stages, since a driver
// may end a loop after 65535 rounds without a word (llvmpipe does).
layout(local_size_x = 16) in;
#include "choice.glsl"

struct Stage { // how far a group's walk has come
    uint next;  // cell
    uint count; // of the cells chosen
    float sum;  // of what they promise
};

layout(std430, binding = 1) readonly buffer Groups { Group groups[]; };
layout(std430, binding = 2) buffer Ends { uint ends[]; }; // counts, or where each group's list begins
layout(std430, binding = 3) buffer Stages { Stage stages[]; };
layout(std430, binding = 4) readonly buffer Corners { vec4 corners[]; }; // three a cell; w of the first: what it is taken to send
#ifdef FILL
layout(std430, binding = 5) writeonly buffer Aims { Aim aims[]; };
#endif
uniform int group_count;
uniform int stage_end; // the cell at which this stage of the walk ends

const float ONE_WAY = 0.999999; // a cosine: equal normals, as float32 rounds them

// Whether no receiver of the group can see any of the cell, whatever its place and normal: conservative.
bool is_hidden(Group group, uint cell) {
    if (group.normal.w > ONE_WAY && cells[cell].more.x == 0.0) {
        // All receivers face one way, and what a flat cell stands for lies between its corners.
        vec3 m = group.normal.xyz, a = corners[3u * cell].xyz, b = corners[3u * cell + 1u].xyz, c = corners[3u * cell + 2u].xyz;
        vec3 d = cells[cell].more.y < 1.5 ? a : b + c - a;
        return max(max(dot(m, a), dot(m, b)), max(dot(m, c), dot(m, d))) <= group.behind + COPLANAR;
    }
    vec4 sphere = sphere_of(cell);
    vec3 to = sphere.xyz - group.sphere.xyz;
    float reach = sphere.w + group.sphere.w, away = length(to);
    if (away <= reach || group.normal.w <= 0.0) return false;
    // The angle from the mean normal, less what cell and group subtend and what the normals vary, is beyond 90°.
    float angle = acos(clamp(dot(to / away, group.normal.xyz), -1.0, 1.0));
    return angle - asin(reach / away) - acos(clamp(group.normal.w, -1.0, 1.0)) > 1.5708;
}

void main() {
    int at = int(gl_GlobalInvocationID.x);
    if (at >= group_count) return;
    Group group = groups[at];
    Stage stage = stages[at];
#ifdef FILL
    uint begin = ends[at];
#endif
    uint k = stage.next;
    while (group.count > 0.0 && k < uint(stage_end)) {
        if (!glows(k) || is_hidden(group, k)) {
            k = after(k);
            continue;
        }
        if (!is_aim(group, k)) {
            ++k;
            continue;
        }
#ifdef FILL
        stage.sum += corners[3u * k].w * promise(group, k);
        aims[begin + stage.count] = Aim(k, stage.sum);
#endif
        ++stage.count;
        k = after(k);
    }
    stage.next = k;
    stages[at] = stage;
#ifndef FILL
    ends[at] = stage.count;
#endif
}
