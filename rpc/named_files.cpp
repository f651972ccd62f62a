// SPDX-License-Identifier: Apache-2.0
// Which rasters may be opened, and which files they may name.
#include "satsurf/rpc/gdal.h"

#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <map>
#include <sstream>

namespace satsurf::rpc {
namespace {

namespace fs = std::filesystem;

/// Whether a driver may open files here.
bool is_allowed(const std::string& driver) {
  return std::ranges::any_of(raster_drivers(), [&](const std::string& name) {
    return EQUAL(name.c_str(), driver.c_str());
  });
}

void check_channels(const fs::path& path);

/// Looks at what a VRT names before GDAL does, which may open it at once.
class VrtCheck {
 public:
  /// returns  how many rasters that are no VRTs it reads, one that is named twice as two
  /// throws   IoError
  double look_at(const fs::path& vrt, int depth = 0);

 private:
  double look_into(const fs::path& vrt, const CPLXMLNode* node, int depth);
  double look_at_source(const fs::path& vrt, const CPLXMLNode* element, int depth);

  std::map<fs::path, double> known_;  ///< sources that are all right, and what they read
};

/// throws  IoError unless a VRT's source is a file here, of a known format
double VrtCheck::look_at_source(const fs::path& vrt, const CPLXMLNode* element, int depth) {
  const std::string said = CPLGetXMLValue(element, nullptr, "");
  const bool relative = std::atoi(CPLGetXMLValue(element, "relativeToVRT", "0")) != 0;
  const fs::path source = relative ? vrt.parent_path() / said : fs::path(said);
  const std::string where = vrt.string() + ": its source \"" + said.substr(0, 200) + "\"";
  if (!is_file(source)) throw IoError(where + " is no file, expected a raster on this machine");
  std::error_code unknown;
  const fs::path file = fs::canonical(source, unknown);  // which may be spelled in many ways
  if (unknown) throw IoError(where + " cannot be found, expected a raster on this machine");
  if (const auto known = known_.find(file); known != known_.end()) return known->second;
  const std::string format = format_of(source.string());
  if (!is_allowed(format))
    throw IoError(where + " is " + (format.empty() ? "no raster" : "of the format " + format) +
                  ", expected GeoTIFF, NITF or alike" + allow_text(format));
  if (format == "PCIDSK") check_channels(source);
  return known_[file] = format == "VRT" ? look_at(source, depth + 1) : 1;
}

/// Whether an element names a file besides the sources: a model of heights, overviews, the places of
/// pixels.
bool names_file(const CPLXMLNode& element) {
  if (EQUAL(element.pszValue, "DEMPath")) return true;
  const std::string_view key = CPLGetXMLValue(&element, "key", "");
  return EQUAL(element.pszValue, "MDI") &&
         (key == "OVERVIEW_FILE" || key == "X_DATASET" || key == "Y_DATASET");
}

double VrtCheck::look_into(const fs::path& vrt, const CPLXMLNode* node, int depth) {
  const auto check_name = [&](std::string_view name, const char* remote) {
    if (name.find(remote) != std::string_view::npos)
      throw IoError(vrt.string() + ": names \"" + std::string(name.substr(0, 200)) +
                    "\", expected files on this machine");
  };
  double rasters = 0;
  for (; node != nullptr; node = node->psNext) {
    if (node->eType == CXT_Text) check_name(node->pszValue, "/vsi");
    if (node->eType == CXT_Element && names_file(*node))
      check_name(CPLGetXMLValue(node, nullptr, ""), "://");
    if (node->eType == CXT_Element &&
        (EQUAL(node->pszValue, "SourceFilename") || EQUAL(node->pszValue, "SourceDataset")))
      rasters += look_at_source(vrt, node, depth);
    rasters += look_into(vrt, node->psChild, depth);  // GDAL's parser bounds the nesting
  }
  return rasters;
}

double VrtCheck::look_at(const fs::path& vrt, int depth) {
  constexpr int kMostDepth = 8;  // mosaics of mosaics; one that names itself would not end
  if (depth > kMostDepth)
    throw IoError(vrt.string() + ": a VRT of VRTs nested deeper than " +
                  std::to_string(kMostDepth) + ", expected files");
  const std::string text = read_text_file(vrt, "a VRT");
  const XmlPtr root(CPLParseXMLString(text.c_str()));
  if (!root) throw IoError(vrt.string() + ": damaged VRT; " + gdal_error());
  const double rasters = look_into(vrt, root.get(), depth);
  constexpr double kMostRasters = 1e5;  // eight VRTs that name the next eight times would be 8^8
  if (depth > 0 || rasters <= kMostRasters) return rasters;  // the file that came is told
  std::ostringstream said;
  said << vrt.string() << ": a VRT that reads " << rasters
       << " rasters, counted as often as it names them, expected at most " << kMostRasters;
  throw IoError(said.str());
}

/// A number or a name in a PCIDSK file's header, without the blanks around it.
std::string pcidsk_field(const std::string& header, std::size_t begin, std::size_t size) {
  constexpr std::string_view kBlank(" \0", 2);
  const std::string text = begin < header.size() ? header.substr(begin, size) : "";
  const std::size_t first = text.find_first_not_of(kBlank), last = text.find_last_not_of(kBlank);
  return first == std::string::npos ? "" : text.substr(first, last - first + 1);
}

/// Looks at the files in which a PCIDSK file's channels lie, which its driver opens by itself.
/// throws  IoError for one that is no file here, or is named elsewhere in the file
void check_channels(const fs::path& path) {
  constexpr std::size_t kBlock = 512, kChannel = 1024;  // bytes: file header, header of a channel
  std::ifstream in(path, std::ios::binary);
  std::string header(kBlock, '\0');
  if (!in.read(header.data(), kBlock)) return;
  const double start = parse_number(pcidsk_field(header, 336, 16)).value_or(0);
  const double count = parse_number(pcidsk_field(header, 376, 8)).value_or(0);
  if (!(start >= 1 && start < 1e12)) return;
  in.seekg((static_cast<std::streamoff>(start) - 1) * static_cast<std::streamoff>(kBlock));
  for (double i = 0; i < count; ++i) {
    std::string channel(kChannel, '\0');
    if (!in.read(channel.data(), kChannel)) return;
    const std::string name = pcidsk_field(channel, 64, 64);
    if (name.empty() || name.starts_with("/SIS=")) continue;  // in the file itself
    const fs::path beside = path.parent_path() / name;
    if (!name.starts_with("LNK=") && is_file(path_exists(beside) ? beside : fs::path(name)))
      continue;
    throw IoError(path.string() + ": a channel lies in \"" + name +
                  "\", expected it in the file or in another on this machine");
  }
}

}  // namespace

void check_format(const fs::path& path) {
  const std::string name = path.string(), format = format_of(name);
  if (!format.empty() && !is_allowed(format))
    throw IoError(name + ": of the format " + format + ", expected GeoTIFF, NITF or alike" +
                  allow_text(format));
  if (format == "VRT") VrtCheck().look_at(path);
  if (format == "PCIDSK") check_channels(path);
}

}  // namespace satsurf::rpc
