// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/interrupt.h"
#include "satsurf/app/log.h"
#include "satsurf/app/program.h"
#include "satsurf/core/error.h"
#include "satsurf/core/isa.h"
#include "satsurf/core/parallel.h"
#include "satsurf/core/version.h"
#include "satsurf/rpc/drivers.h"

#include <cstdio>
#include <new>
#include <string>

#if defined(__GLIBC__)
#include <malloc.h>
#endif

namespace satsurf::app {
namespace {

enum ExitCode { kDone = 0, kFailed = 1, kUsage = 2, kSignal = 128 };

/// Keeps what large vectors give back for the next ones: a page costs less to fill than to get.
void keep_freed_memory() {
#if defined(__GLIBC__)
  ::mallopt(M_MMAP_THRESHOLD, 64 << 20);
  ::mallopt(M_TRIM_THRESHOLD, 256 << 20);
#endif
}

void complain(const std::string& text) { log_line(LogLevel::error, text); }

/// What ran, for whoever reads the log alone.
void log_command(int argc, char** argv) {
  std::string text = std::string(program_version()) + " (" + program_git_hash() + "), " +
                     isa_name(active_isa()) + ", " + std::to_string(threads()) + " threads:";
  for (int i = 0; i < argc; ++i) text += std::string(" ") + argv[i];
  log_line(LogLevel::debug, text);
}

/// What a user may do about it.
std::string out_of_memory_text(const CLI::App& command) {
  const bool resolution = command.get_option_no_throw("--resolution") != nullptr;
  return std::string("out of memory; try fewer --threads") +
         (resolution ? ", smaller images or a coarser --resolution" : " or smaller images");
}

void add_commands(Program& program) {
  for (const auto add : {add_info, add_simulate, add_train, add_reconstruct, add_evaluate,
                         add_render, add_export, add_help})
    add(program);
}

int run_program(int argc, char** argv) {
  Program program;
  CLI::App& app = program.app;
  app.set_version_flag(
      "--version", std::string("satsurf ") + program_version() + " (" + program_git_hash() + ")");
  app.require_subcommand(1);
  app.get_formatter()->column_width(44);
  app.footer(
      "Exit codes: 0 done, 1 failed, 2 wrong usage, 128 + n stopped by signal n (130: Ctrl-C).");
  add_commands(program);
  if (argc > 1 && argv[1][0] != '-' && program.find(argv[1]) == nullptr) {
    complain(unknown_command(program, argv[1]));
    return kUsage;
  }
  try {
    app.parse(argc, argv);
  } catch (const CLI::Success& e) {
    app.exit(e);  // prints help or version
    return kDone;
  } catch (const CLI::ExtrasError&) {
    complain(unexpected_arguments(program, app.remaining(true)));
    return kUsage;
  } catch (const CLI::ParseError& e) {
    complain(wrong_value(program, e.what()) + help_hint(program));
    return kUsage;
  }
  survive_file_limits();
  keep_freed_memory();
  open_log(program.common.log_level, program.common.quiet, program.common.log_file);
  set_threads(program.common.threads);
  rpc::trust_drivers(program.common.gdal_drivers);
  log_command(argc, argv);
  catch_interrupts();
  try {
    program.run();
  } catch (const std::bad_alloc&) {
    throw Error(out_of_memory_text(*app.get_subcommands().front()));
  } catch (const IoError& e) {
    const CLI::App& called = *app.get_subcommands().front();
    throw IoError(with_flag(e.what(), called.get_option_no_throw("--image-dir") != nullptr));
  }
  if (std::fflush(stdout) != 0) throw IoError("stdout: cannot be written");
  return kDone;
}

}  // namespace
}  // namespace satsurf::app

int main(int argc, char** argv) {
  using namespace satsurf::app;
  try {
    return run_program(argc, argv);
  } catch (const Interrupted&) {
    complain("stopped");
    return kSignal + interrupt_signal();
  } catch (const AlreadyTold&) {
    return kFailed;
  } catch (const satsurf::ConfigError& e) {
    complain(e.what());
    return kUsage;
  } catch (const std::bad_alloc&) {
    complain("out of memory");
    return kFailed;
  } catch (const std::exception& e) {
    complain(e.what());
    return kFailed;
  }
}
