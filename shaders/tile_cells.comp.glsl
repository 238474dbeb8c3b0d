#version 430
// Chooses, for each group of a tile, the cells that stand for the whole scene as seen from there: one thread a group.
// The walk goes down where a cell looks too large, and passes over what lies behind all receivers.
// Run twice: once to count, once, with FILL, to write where the count has made room; each time in stages, since a driver
// may end a loop after 65535 rounds without a word (llvmpipe does).
layout(local_size_x = 16) in;
#include "tiles.glsl"

struct Stage { // how far a group's walk has come
    uint next;  // cell
    uint count; // of the cells chosen
    float sum;  // of what they promise
};

layout(std430, binding = 0) readonly buffer Groups { Group groups[]; };
layout(std430, binding = 1) readonly buffer Walk { Cell cells[]; };
layout(std430, binding = 2) readonly buffer Skip { uint skip[]; };
layout(std430, binding = 3) buffer Ends { uint ends[]; }; // counts, or where each group's list begins
layout(std430, binding = 4) buffer Stages { Stage stages[]; };
#ifdef FILL
layout(std430, binding = 5) writeonly buffer Lists { uint lists[]; };
// How much light a cell may send to the group, per area of the cell, and summed over the list.
layout(std430, binding = 6) writeonly buffer Guides { vec2 guides[]; };
#endif
uniform int group_count;
uniform int stage_end; // the cell at which this stage of the walk ends
uniform float detail;

const float ONE_WAY = 0.999999; // a cosine: equal normals, as float32 rounds them
const float ERRORS = 3.0; // a likeness must be this much better than its size

// Whether no receiver of the group can see any of the cell, whatever its place and normal: conservative.
bool is_hidden(Group group, Cell cell) {
    if (group.normal.w > ONE_WAY && cell.more.x == 0.0) {
        // All receivers face one way, and what a flat cell stands for lies between its corners.
        vec3 m = group.normal.xyz;
        vec3 d = cell.more.y > 0.0 ? cell.a.xyz : cell.b.xyz + cell.c.xyz - cell.a.xyz;
        float highest = max(max(dot(m, cell.a.xyz), dot(m, cell.b.xyz)), max(dot(m, cell.c.xyz), dot(m, d)));
        return highest <= group.behind + COPLANAR;
    }
    vec3 to = cell.sphere.xyz - group.sphere.xyz;
    float reach = cell.sphere.w + group.sphere.w, away = length(to);
    if (away <= reach || group.normal.w <= 0.0) return false;
    // The angle from the mean normal, less what cell and group subtend and what the normals vary, is beyond 90°.
    float angle = acos(clamp(dot(to / away, group.normal.xyz), -1.0, 1.0));
    return angle - asin(reach / away) - acos(clamp(group.normal.w, -1.0, 1.0)) > 1.5708;
}

// Whether a cell may stand for its parts. A flat one blocks as they do, and rays find the part that they meet of it: only
// where it sends, and is aimed at, does its size matter.
bool is_fine(Cell cell, float away) {
    float size = cell.more.w > 0.0 ? cell.sphere.w : 0.0, error = cell.more.x < COPLANAR ? 0.0 : ERRORS * cell.more.x;
    return size + error <= detail * max(away, 0.0);
}

#ifdef FILL
// Radiance apart: area times both cosines over the square of the distance, each as large as group and cell allow.
float promise(Group group, Cell cell, out float area) {
    vec3 across = cross(cell.b.xyz - cell.a.xyz, cell.c.xyz - cell.a.xyz);
    area = length(across) * (cell.more.y > 0.0 ? 0.5 : 1.0);
    vec3 to = cell.sphere.xyz - group.sphere.xyz;
    float reach = cell.sphere.w + group.sphere.w, away = max(length(to), 1e-6), spread = reach / away;
    float sent = clamp(dot(normalize(across), -to / away) + spread, 0.0, 1.0);
    float cone = sqrt(max(1.0 - group.normal.w * group.normal.w, 0.0));
    float caught = group.normal.w <= 0.0 ? 1.0 : clamp(dot(group.normal.xyz, to / away) + spread + cone, 0.0, 1.0);
    return area * sent * caught / max(away * away, reach * reach);
}
#endif

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
        Cell cell = cells[k];
        if (is_hidden(group, cell)) {
            k = skip[k];
            continue;
        }
        bool is_leaf = skip[k] == k + 1u;
        float away = distance(cell.sphere.xyz, group.sphere.xyz) - cell.sphere.w - group.sphere.w;
        if (!is_leaf && !is_fine(cell, away)) {
            ++k;
            continue;
        }
#ifdef FILL
        lists[begin + stage.count] = k;
        float area = 1.0, hope = cell.more.z > 0.0 ? promise(group, cell, area) : 0.0;
        stage.sum += hope;
        guides[begin + stage.count] = vec2(hope / area, stage.sum);
#endif
        ++stage.count;
        k = skip[k];
    }
    stage.next = k;
    stages[at] = stage;
#ifndef FILL
    ends[at] = stage.count;
#endif
}
