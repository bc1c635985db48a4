/*  calibrate.c - makes a trained model fit for int8: the ranges of its layers, from characters in motion
    shows     dn_probe on real frames; how int8 then differs from float32 (common/ranges.h has the choice of ranges)
    not here  training: the weights stay as they are. f16 and bf16 need no ranges
    build     make calibrate
    run       ./calibrate --model M.safetensors --character A.glb --character B.glb --motion rom.glb --out M8.safetensors
              ./calibrate --out humanoid8.safetensors        the shipped model on the bundled demo
    poses     like those that the model will see, on characters like those it will see: a channel that goes farther later is
              clipped. A few hundred frames are enough
    flow      characters x motions --float32 network--> histograms of every channel --> NAME.range (2,width) in the file */
#define _POSIX_C_SOURCE 200809L
#define DEFORMNET_IMPLEMENTATION
#include "../deformnet.h"
#include "common/ranges.h"
#include "common/pool.h"
#include "common/scene.h"
#include "common/tool.h"
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* ===================================================================================== >>options */
static const char usage[] =
   "usage: calibrate [--model M.safetensors] [--character C.glb|C.safetensors].. [--motion A.glb|T.safetensors]..\n"
   "                 [--animation NAME] [--frames n] [--ends clipped|seen] [--threads n] --out O.safetensors\n"
   "  without --character and --motion: the bundled demo; without --model: the model that ships\n"
   "  --character  several: every motion is played on each; without --motion their own animations\n"
   "  --frames n   of each motion, evenly spread (24)\n"
   "  --ends       clipped: ranges leave out rare numbers where that lowers the squared error (the default); seen: they end\n"
   "               at the least and the most that was seen\n"
   "  --out        may be the model itself. All else in the file stays as it is\n";

enum { MOST = 64 };
typedef struct options {
   const char *model, *out, *animation, *character[MOST], *motion[MOST];
   size_t characters, motions, frames;
   int clip;
   unsigned threads;
} options;

static int read_options(options *o, int argc, char **argv)
{
   int i;
   memset(o, 0, sizeof *o);
   o->frames = 24;
   o->clip = 1;
   for (i = 1; i < argc; i++) {
      const char *key = argv[i], *value = i + 1 < argc ? argv[i + 1] : NULL;
      long n;
      if (strcmp(key, "--help") == 0 || strcmp(key, "-h") == 0) {
         fputs(usage, stdout);
         exit(0);
      }
      if (!value) return ex_say("%s is unknown or needs a value (--help lists all)", key);
      i++;
      if (strcmp(key, "--model") == 0) o->model = value;
      else if (strcmp(key, "--out") == 0) o->out = value;
      else if (strcmp(key, "--animation") == 0) o->animation = value;
      else if (strcmp(key, "--character") == 0 && o->characters < MOST) o->character[o->characters++] = value;
      else if (strcmp(key, "--motion") == 0 && o->motions < MOST) o->motion[o->motions++] = value;
      else if (strcmp(key, "--character") == 0 || strcmp(key, "--motion") == 0) return ex_say("%s: at most %d", key, MOST);
      else if (strcmp(key, "--ends") == 0) {
         if (strcmp(value, "clipped") != 0 && strcmp(value, "seen") != 0) return ex_say("--ends %s: expected clipped or seen", value);
         o->clip = value[0] == 'c';
      } else if (strcmp(key, "--frames") == 0) {
         if (!ex_read_whole(value, 1, 1000000, &n)) return ex_say("--frames %s: expected a number from 1 on", value);
         o->frames = (size_t)n;
      } else if (strcmp(key, "--threads") == 0) {
         if (!ex_read_whole(value, 1, 256, &n)) return ex_say("--threads %s: expected 1 to 256", value);
         o->threads = (unsigned)n;
      } else return ex_say("unknown argument \"%s\" (--help lists them)", key);
   }
   if (!o->out) return ex_say("needs --out (--help lists all)");
   if (o->motions && !o->characters) return ex_say("--motion: needs --character");
   if (!o->threads) o->threads = ex_processors();
   return 0;
}

/* ===================================================================================== >>frames */
typedef struct job {
   options o;
   dn_model *model;
   ex_ranges *ranges;
   ex_pool *pool;
   dn_parallel parallel;
   size_t frames, unfit; /* run; those that were not finite, and were left out as far as they were not */
} job;

/* the network on frames of one motion of one character, tapped */
static int watch(job *j, const dn_rig *rig, const ex_scene *scene, const ex_motion *motion, void *scratch, size_t bytes)
{
   dn_probe probe = ex_ranges_probe(j->ranges);
   size_t count = motion->frames < j->o.frames ? motion->frames : j->o.frames, k;
   float *palette = (float *)ex_take(scene->joints, 12 * sizeof *palette);
   int bad = palette ? 0 : ex_say("out of memory");
   for (k = 0; k < count && !bad; k++) {
      dn_pose pose;
      dn_error err;
      dn_result result;
      memset(&pose, 0, sizeof pose);
      ex_pose(scene, motion, (2 * k + 1) * motion->frames / (2 * count), palette);
      pose.palette = palette;
      pose.strength = 1;
      result = dn_stage_skin(rig, &pose, scratch, bytes, &j->parallel, &err);
      if (result != DN_OK && result != DN_NOT_FINITE) bad = ex_say_error(scene->path, &err);
      else {
         j->unfit += result != DN_OK;
         dn_stage_rows(rig, scratch, &j->parallel);
         dn_stage_network(rig, scratch, &j->parallel, &probe);
         j->frames++;
      }
   }
   free(palette);
   return bad;
}
static int watch_character(job *j, const char *path, const char *const *motions, size_t count)
{
   char error[EX_ERROR];
   ex_scene *scene = ex_scene_load(path, error);
   ex_motion *motion;
   dn_rig_desc d;
   dn_skin_set skin;
   dn_error err;
   dn_rig *rig;
   void *scratch = NULL;
   size_t bytes = 0, k;
   int bad = 0;
   if (!scene) return ex_say("%s", error);
   ex_describe(scene, &d, &skin);
   d.parallel = &j->parallel;
   rig = dn_rig_create(j->model, &d, NULL, NULL, &err);
   if (rig) scratch = dn_scratch_create(rig, j->parallel.workers, NULL, &bytes, &err);
   if (!scratch) bad = ex_say_error(path, &err);
   for (k = 0; k < count && !bad; k++) {
      motion = ex_motion_load(motions[k], j->o.animation, scene, error);
      bad = motion ? watch(j, rig, scene, motion, scratch, bytes) : ex_say("%s", error);
      ex_motion_free(motion);
   }
   dn_scratch_free(scratch, bytes, NULL);
   dn_rig_free(rig);
   ex_scene_free(scene);
   return bad;
}

/* ===================================================================================== >>main */
static int run(job *j, int argc, char **argv)
{
   char paths[3][1024], error[EX_ERROR];
   const char *program = argc ? argv[0] : "calibrate", *model, *name;
   dn_model_info info;
   dn_error err;
   ex_ranges_report report;
   size_t k, width, tensors = 0;
   if (read_options(&j->o, argc, argv)) return 1;
   model = j->o.model ? j->o.model : ex_bundled(program, "models/humanoid.safetensors", paths[0], sizeof paths[0]);
   if (!j->o.characters) {
      j->o.character[j->o.characters++] = ex_bundled(program, "demo/humanoid.safetensors", paths[1], sizeof paths[1]);
      j->o.motion[j->o.motions++] = ex_bundled(program, "demo/truth.safetensors", paths[2], sizeof paths[2]);
   }
   j->model = dn_model_load_file(model, NULL, NULL, &err);
   if (!j->model) return ex_say_error(model, &err);
   dn_model_describe(j->model, &info);
   if (j->o.threads > 1 && !(j->pool = ex_pool_create(j->o.threads))) return ex_say("cannot start %u threads", j->o.threads);
   j->parallel = ex_pool_parallel(j->pool);
   j->ranges = ex_ranges_create();
   if (!j->ranges) return ex_say("out of memory");
   for (k = 0; k < j->o.characters; k++) {
      const char *own = j->o.character[k];
      if (watch_character(j, own, j->o.motions ? j->o.motion : &own, j->o.motions ? j->o.motions : 1)) return 1;
   }
   if (!ex_ranges_choose(j->ranges, j->o.clip)) return ex_say("out of memory");
   if (!ex_ranges_save(j->ranges, model, j->o.out, error)) return ex_say("%s", error);
   while (ex_ranges_at(j->ranges, tensors, &name, &width)) tensors++;
   report = ex_ranges_describe(j->ranges);
   printf("model       %s: %s\n", model, info.arch_name);
   printf("seen        %zu frames, %zu characters", j->frames, j->o.characters);
   if (j->unfit) printf(" (%zu frames with palettes that are not finite)", j->unfit);
   printf("\nranges      %zu tensors, %zu channels; %zu of them leave out numbers, %.3g %% of all\n", tensors, report.channels, report.clipped,
          report.numbers > 0 ? 100 * report.outside / report.numbers : 0);
   printf("wrote       %s\n", j->o.out);
   return 0;
}

int main(int argc, char **argv)
{
   static job j;
   int code;
   ex_program("calibrate");
   code = run(&j, argc, argv);
   ex_ranges_free(j.ranges);
   ex_pool_free(j.pool);
   dn_model_free(j.model);
   return code;
}
