// The cells at which rays of a group are aimed: small ones from where it is, by what they promise to send to it.
#include "tiles.glsl"
#include "cells.glsl"

struct Aim {
    uint cell;
    float sum; // of what the list's cells promise, to this one
};

// Whether it may stand for its parts where what it sends matters.
bool is_aim(Group group, uint cell) {
    return is_apart(group.sphere, cells[cell].aim.xyz, cells[cell].aim.w);
}

// Of each of a cell's areas, radiance apart: both cosines over the square of the distance, as large as group and cell allow.
float promise(Group group, uint cell) {
    vec4 sphere = sphere_of(cell);
    vec3 to = sphere.xyz - group.sphere.xyz;
    float reach = sphere.w + group.sphere.w, away = max(length(to), 1e-6), spread = reach / away;
    float sent = clamp(dot(cells[cell].N.xyz, -to / away) + spread, 0.0, 1.0);
    float cone = sqrt(max(1.0 - group.normal.w * group.normal.w, 0.0));
    float caught = group.normal.w <= 0.0 ? 1.0 : clamp(dot(group.normal.xyz, to / away) + spread + cone, 0.0, 1.0);
    return sent * caught / max(away * away, reach * reach);
}
